// A hull in the scene, at its own size and grown about its contraction point.

import { BufferGeometry, Float32BufferAttribute, Group, Mesh } from 'three';
import { corners, edges, Pose, vertex } from './geometry.js';
import { clear, glass, lines } from './look.js';
import type { Body, Feature, Hull, Side } from './model.js';

const MANY_EDGES = 100;

export class BodyView {
  /** Everything of the body, at its pose. */
  readonly group = new Group();
  private readonly solid = new Group();
  private readonly grown = new Group();
  private readonly feature = new Group();
  private readonly focus = new Group();
  private hull: Hull | undefined;

  constructor(private readonly side: Side) {
    this.group.add(this.solid, this.grown, this.feature, this.focus);
    this.focus.visible = false;
  }

  setHull(hull: Hull): void {
    this.hull = hull;
    for (const group of [this.solid, this.grown, this.feature, this.focus]) clear(group);
    const outline = outlineOf(hull);
    // With many edges the lines are thin and faint, otherwise they would hide the hull.
    const fine = outline.length / 6 > MANY_EDGES;
    const mesh = new Mesh(surface(hull), glass(this.side, fine ? 0.5 : 0.36));
    mesh.userData.side = this.side;
    this.solid.add(mesh, lines(outline, { name: this.side, width: fine ? 0.8 : 1.8, opacity: fine ? 0.5 : 1 }));
    this.grown.add(lines(outline, { name: this.side, width: fine ? 0.7 : 1.2, opacity: fine ? 0.25 : 0.55 }));
    this.grown.add(new Mesh(surface(hull), glass(this.side, 0.09)));
    this.focus.add(lines(outline, { name: 'ink', width: 3.2, opacity: 0.55 }));
  }

  /** The surface that the pointer can grab. */
  get mesh(): Mesh | undefined {
    return this.solid.children[0] as Mesh | undefined;
  }

  setPose(body: Body): void {
    const { position, rotation } = new Pose(body);
    this.group.position.copy(position);
    this.group.quaternion.copy(rotation);
  }

  /** Moves every point `v` to `c + alpha (v - c)`. Hidden if alpha is almost 0 or not finite. */
  setGrown(alpha: number, isShown: boolean): void {
    this.grown.visible = isShown && alpha > 1e-6 && Number.isFinite(alpha);
    const [x, y, z] = this.hull?.centre ?? [0, 0, 0];
    this.grown.scale.setScalar(alpha || 1);
    this.grown.position.set(x, y, z).multiplyScalar(1 - alpha);
  }

  /** Highlights the face, edge or vertex that touches. */
  setFeature(feature: Feature | undefined): void {
    clear(this.feature);
    if (!this.hull || !feature) return;
    const outline = corners(this.hull, feature);
    if (outline.length < 2) return;
    const closed = outline.length > 2 ? [...outline, outline[0]!] : outline;
    const segments = closed.slice(1).flatMap((p, i) => [...closed[i]!.toArray(), ...p.toArray()]);
    this.feature.add(lines(segments, { name: this.side, width: 4, onTop: true }));
  }

  setFocus(hasFocus: boolean): void {
    this.focus.visible = hasFocus;
  }
}

function outlineOf(hull: Hull): number[] {
  return edges(hull).flatMap(({ ends }) => ends.flatMap((i) => vertex(hull, i).toArray()));
}

/** The triangles of the hull: faces are convex, so each is one fan. */
function surface(hull: Hull): BufferGeometry {
  const corner = (i: number) => hull.vertices.slice(3 * i, 3 * i + 3);
  const triangles = hull.faces.flatMap((face) =>
    face.slice(2).flatMap((third, i) => [face[0]!, face[i + 1]!, third].flatMap(corner)),
  );
  const geometry = new BufferGeometry();
  geometry.setAttribute('position', new Float32BufferAttribute(triangles, 3));
  geometry.computeVertexNormals();
  return geometry;
}
