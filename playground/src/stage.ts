// Figure 1: the two hulls, at their own size and grown until they touch, and their contact.

import {
  BufferGeometry,
  ConeGeometry,
  Float32BufferAttribute,
  Group,
  Mesh,
  SphereGeometry,
  Vector3,
} from 'three';
import { OrbitControls } from 'three/addons/controls/OrbitControls.js';
import { BodyView } from './bodies.js';
import { Plane, Pose, round, touch } from './geometry.js';
import { clear, kept, lines, marker, type Name } from './look.js';
import { SIDES, type Answer, type Hull, type Scene, type Side, type Triple } from './model.js';
import { View } from './view.js';

/** The space around a fitted body, in circumradii: it may be shown grown. */
const ROOM = 0.82;

const BALL = kept(new SphereGeometry(1, 16, 12));
const CONE = kept(new ConeGeometry(0.035, 0.1, 20));

/** The parts that the reader may hide. */
export interface Shown {
  grown: boolean;
  points: boolean;
  features: boolean;
}

export class Stage {
  readonly view: View;
  readonly bodies: Record<Side, BodyView> = { a: new BodyView('a'), b: new BodyView('b') };
  readonly controls: OrbitControls;
  readonly hulls: Partial<Record<Side, Hull>> = {};
  shown: Shown = { grown: true, points: true, features: true };
  private readonly contact = new Group();

  constructor(frame: HTMLElement, moved: () => void) {
    this.view = new View(frame);
    this.view.add(this.bodies.a.group, this.bodies.b.group, this.contact);
    this.controls = new OrbitControls(this.view.camera, this.view.canvas);
    this.controls.enablePan = false;
    this.controls.addEventListener('change', () => {
      this.view.draw();
      moved();
    });
  }

  /** Looks at the middle of the bodies from the scene's camera position. */
  look(scene: Scene): void {
    const { a, b } = scene.bodies;
    this.controls.target.addVectors(new Vector3(...a.position), new Vector3(...b.position)).multiplyScalar(0.5);
    this.view.camera.position.copy(this.controls.target).add(new Vector3(...scene.view));
    this.controls.update();
  }

  /** Brings both bodies into view without changing the direction of view. */
  fit(scene: Scene): void {
    const { a, b } = scene.bodies;
    const [from, to] = [new Vector3(...a.position), new Vector3(...b.position)];
    const { camera } = this.view;
    const half = (Math.PI / 360) * camera.fov;
    const room = from.distanceTo(to) / 2 + ROOM * this.size;
    const away = room / Math.sin(half) / Math.min(1, camera.aspect);
    const direction = new Vector3(...this.from).setLength(away);
    this.look({ ...scene, view: direction.toArray() });
  }

  /** The camera's position relative to the point that it looks at. */
  get from(): Triple {
    return this.view.camera.position.clone().sub(this.controls.target).toArray();
  }

  /** The larger circumradius, the unit of all drawn sizes. */
  get size(): number {
    return Math.max(...SIDES.map((side) => this.hulls[side]?.circumradius ?? 0)) || 1;
  }

  setHull(side: Side, hull: Hull): void {
    this.hulls[side] = hull;
    this.bodies[side].setHull(hull);
    const { camera } = this.view;
    [camera.near, camera.far] = [this.size / 100, this.size * 1000];
    camera.updateProjectionMatrix();
  }

  setPoses(scene: Scene): void {
    for (const side of SIDES) {
      this.bodies[side].setPose(scene.bodies[side]);
      const hull = this.hulls[side];
      if (hull) {
        const centre = new Pose(scene.bodies[side]).point(new Vector3(...hull.centre));
        this.view.label(side, side.toUpperCase(), centre);
      }
    }
    this.view.draw();
  }

  setAnswer(scene: Scene, answer: Answer | undefined): void {
    clear(this.contact);
    this.view.unlabel('point');
    this.view.label('normal', '', undefined);
    for (const side of SIDES) {
      this.bodies[side].setGrown(answer?.alpha ?? NaN, this.shown.grown);
      this.bodies[side].setFeature(this.shown.features ? answer?.features[side] : undefined);
    }
    if (answer && Number.isFinite(answer.alpha)) this.drawContact(scene, answer);
    this.view.draw();
  }

  private drawContact(scene: Scene, answer: Answer): void {
    const n = new Vector3(...answer.normal);
    const onA = answer.points.map((point) => new Vector3(...point.onA));
    const onB = onA.map((p, i) => p.clone().addScaledVector(n, answer.points[i]!.distance));
    const middles = onA.map((p, i) => p.clone().add(onB[i]!).multiplyScalar(0.5));
    const of = (side: Side): [Hull, Pose] => [this.hulls[side]!, new Pose(scene.bodies[side])];
    for (const side of SIDES) {
      const [hull, pose] = of(side);
      this.drawBall(pose.point(new Vector3(...hull.centre)), side, 0.013);
    }
    const touching = touch(answer, of('a'), of('b'));
    const middle = middles.length > 0 ? mean(middles) : touching;
    if (middle) this.drawNormal(middle, n);
    if (this.shown.grown && touching) this.drawBall(touching, 'ink', 0.014);
    if (!this.shown.points) return;
    this.drawPatch(middles, answer.normal);
    onA.forEach((p, i) => {
      this.drawBall(p, 'contact', 0.016);
      this.drawBall(onB[i]!, 'contact', 0.016);
      this.contact.add(lines([...p.toArray(), ...onB[i]!.toArray()], { name: 'contact', width: 2.5, onTop: true }));
      if (onA.length <= 12) this.view.label(`point${i}`, `${i + 1}`, middles[i], 'point');
    });
  }

  /** Draws the normal, from A to B. */
  private drawNormal(from: Vector3, n: Vector3): void {
    const tip = from.clone().addScaledVector(n, 0.75 * this.size);
    const foot = from.clone().addScaledVector(n, 0.65 * this.size);
    this.contact.add(lines([...from.toArray(), ...foot.toArray()], { name: 'normal', width: 3.5, onTop: true }));
    const head = new Mesh(CONE, marker('normal'));
    head.scale.setScalar(this.size);
    head.position.copy(from).addScaledVector(n, 0.7 * this.size);
    head.quaternion.setFromUnitVectors(new Vector3(0, 1, 0), n);
    head.renderOrder = 3;
    this.contact.add(head);
    this.view.label('normal', 'n', tip);
  }

  private drawBall(at: Vector3, name: Name, radius: number): void {
    const ball = new Mesh(BALL, marker(name));
    ball.scale.setScalar(radius * this.size);
    ball.position.copy(at);
    ball.renderOrder = 4;
    this.contact.add(ball);
  }

  private drawPatch(middles: Vector3[], normal: Triple): void {
    if (middles.length < 3) return;
    const plane = new Plane(normal, new Vector3(1, 0, 0), new Vector3(0, 1, 0));
    const flatPoints = middles.map((p) => plane.of(p));
    const order = round(flatPoints).map((p) => middles[flatPoints.indexOf(p)]!);
    const fan = order.slice(2).flatMap((p, i) => [order[0]!, order[i + 1]!, p].flatMap((q) => q.toArray()));
    const geometry = new BufferGeometry();
    geometry.setAttribute('position', new Float32BufferAttribute(fan, 3));
    const patch = new Mesh(geometry, marker('contact', 0.35));
    patch.renderOrder = 2;
    this.contact.add(patch);
  }
}

function mean(points: Vector3[]): Vector3 {
  return points.reduce((sum, p) => sum.add(p), new Vector3()).divideScalar(points.length);
}
