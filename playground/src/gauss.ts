// Figure 2: the Gauss maps of A and of B, the latter negated. Each is a unit sphere on which a face is the point of
// its normal, an edge the arc between the normals of its two faces, and a vertex the region between its edges' arcs.

import { Group, InstancedMesh, Matrix4, Mesh, SphereGeometry, Vector3, type Camera } from 'three';
import { FeatureKind } from './generated/hullcast/v1/contacts_pb.js';
import { edges, Pose, type Edge } from './geometry.js';
import { clear, lines, plain } from './look.js';
import { SIDES, type Answer, type Feature, type Hull, type Scene, type Side } from './model.js';
import { View } from './view.js';

/** The distance of each sphere's centre from the middle of the picture. */
const ASIDE = 1.28;
const AWAY = 5.5;
/** The length of an arc's segments, in radians. */
const PIECE = 0.08;

export class GaussMaps {
  private readonly view: View;
  private readonly maps: Record<Side, GaussMap>;

  /** The maps are seen from the same direction as `stage`. */
  constructor(frame: HTMLElement, stage: Camera) {
    this.view = new View(frame);
    this.maps = { a: new GaussMap('a'), b: new GaussMap('b') };
    this.view.add(this.maps.a.group, this.maps.b.group);
    const { camera } = this.view;
    [camera.near, camera.far] = [1, 2 * AWAY];
    this.view.beforeDraw = () => {
      camera.quaternion.copy(stage.quaternion);
      camera.position.set(0, 0, AWAY).applyQuaternion(camera.quaternion);
      const right = new Vector3(1, 0, 0).applyQuaternion(camera.quaternion);
      const wide = Math.min(1, camera.aspect / 1.95);
      camera.zoom = wide;
      camera.updateProjectionMatrix();
      camera.updateMatrixWorld();
      SIDES.forEach((side, i) => {
        const { group, tip } = this.maps[side];
        group.position.copy(right).multiplyScalar((2 * i - 1) * ASIDE);
        this.view.label(side, 'n', tip && tip.clone().add(group.position), 'normal');
      });
    };
  }

  draw(): void {
    this.view.draw();
  }

  setHull(side: Side, hull: Hull): void {
    this.maps[side].setHull(hull);
    this.view.draw();
  }

  setAnswer(scene: Scene, answer: Answer | undefined): void {
    for (const side of SIDES) {
      const map = this.maps[side];
      map.setPose(new Pose(scene.bodies[side]));
      map.setAnswer(answer, answer?.features[side], scene.settings.featureAngle);
    }
    this.view.draw();
  }
}

class GaussMap {
  readonly group = new Group();
  /** The tip of the normal's pin, from the sphere's centre; undefined without an answer. */
  tip: Vector3 | undefined;
  /** Has the hull's rotation. */
  private readonly turned = new Group();
  private readonly tiles = new Group();
  private readonly touched = new Group();
  private readonly normal = new Group();
  private hull: Hull | undefined;
  private edges: Edge[] = [];

  constructor(private readonly side: Side) {
    this.group.add(new Mesh(new SphereGeometry(0.993, 96, 64), plain('sphere', 0.7)));
    this.group.add(this.turned, this.normal);
    this.turned.add(this.tiles, this.touched);
  }

  setHull(hull: Hull): void {
    this.hull = hull;
    this.edges = edges(hull);
    clear(this.tiles);
    clear(this.touched);
    const arcs = this.edges.flatMap((edge) => this.arc(edge));
    this.tiles.add(lines(arcs, { name: this.side, width: this.edges.length > 100 ? 1 : 1.8 }));
    this.tiles.add(lines(arcs, { name: this.side, width: 1, opacity: 0.22, onTop: true }));
    this.tiles.add(this.dots(hull.faceNormals.map((_, f) => this.normalOf(f)), this.edges.length > 100 ? 0.02 : 0.034));
  }

  setPose({ rotation }: Pose): void {
    this.turned.quaternion.copy(rotation);
  }

  setAnswer(answer: Answer | undefined, feature: Feature | undefined, angle: number): void {
    clear(this.touched);
    clear(this.normal);
    this.tip = undefined;
    if (!answer || !feature || !Number.isFinite(answer.alpha)) return;
    this.drawFeature(feature);
    const n = new Vector3(...answer.normal);
    this.tip = n.clone().multiplyScalar(1.42);
    const pin = [...n.toArray(), ...n.clone().multiplyScalar(1.3).toArray()];
    this.normal.add(lines(pin, { name: 'normal', width: 3.5, onTop: true }));
    const dot = this.dots([n], 0.035, 'normal');
    dot.renderOrder = 4;
    this.normal.add(dot);
    // The feature angle: faces and edges within this circle count as touching.
    if (angle > 0) this.normal.add(lines(cap(n, angle), { name: 'normal', width: 1.5, onTop: true }));
  }

  private drawFeature({ kind, indices }: Feature): void {
    const registered = indices.map((index) => this.hull!.vertexOf.get(index) ?? -1);
    const isTouched = ({ ends }: Edge) =>
      kind === FeatureKind.EDGE
        ? registered.every((i) => ends.includes(i))
        : kind === FeatureKind.VERTEX && ends.includes(registered[0]!);
    const arcs = this.edges.filter(isTouched).flatMap((edge) => this.arc(edge));
    if (arcs.length > 0) this.touched.add(lines(arcs, { name: this.side, width: 5, onTop: true }));
    if (kind === FeatureKind.FACE) {
      this.touched.add(this.dots([this.normalOf(indices[0])], 0.06));
    }
  }

  /** The normal of a face in the hull's frame; B's is negated. */
  private normalOf(face: number): Vector3 {
    return new Vector3(...this.hull!.faceNormals[face]!).multiplyScalar(this.side === 'b' ? -1 : 1);
  }

  /** The segments of the arc from one face's normal to the other's. */
  private arc({ faces }: Edge): number[] {
    const [from, to] = faces.map((f) => this.normalOf(f)) as [Vector3, Vector3];
    const angle = from.angleTo(to);
    const pieces = Math.max(1, Math.ceil(angle / PIECE));
    const at = (i: number) => slerp(from, to, angle, i / pieces).toArray();
    return Array.from({ length: pieces }, (_, i) => [...at(i), ...at(i + 1)]).flat();
  }

  private dots(at: Vector3[], radius: number, name: Side | 'normal' = this.side): InstancedMesh {
    const mesh = new InstancedMesh(new SphereGeometry(radius, 12, 8), plain(name), at.length);
    at.forEach((p, i) => mesh.setMatrixAt(i, new Matrix4().setPosition(p)));
    mesh.frustumCulled = false;
    return mesh;
  }
}

function slerp(from: Vector3, to: Vector3, angle: number, share: number): Vector3 {
  if (angle < 1e-9) return from.clone();
  const [p, q] = [Math.sin((1 - share) * angle), Math.sin(share * angle)];
  return from.clone().multiplyScalar(p).addScaledVector(to, q).divideScalar(Math.sin(angle)).normalize();
}

/** The circle on the sphere at this angle from `n`. */
function cap(n: Vector3, angle: number): number[] {
  const across = new Vector3(Math.abs(n.x) < 0.8 ? 1 : 0, Math.abs(n.x) < 0.8 ? 0 : 1, 0).cross(n).normalize();
  const other = n.clone().cross(across);
  const at = (i: number) => {
    const turn = (2 * Math.PI * i) / 48;
    return n
      .clone()
      .multiplyScalar(Math.cos(angle))
      .addScaledVector(across, Math.sin(angle) * Math.cos(turn))
      .addScaledVector(other, Math.sin(angle) * Math.sin(turn))
      .toArray();
  };
  return Array.from({ length: 48 }, (_, i) => [...at(i), ...at(i + 1)]).flat();
}
