// Figure 3: the touching features, projected along the normal onto the contact plane, and their intersection, whose
// corners are the contact points.

import { Vector3, type Camera } from 'three';
import { corners, Plane, Pose, round } from './geometry.js';
import { SIDES, type Answer, type Hull, type Scene, type Side } from './model.js';
import { short } from './words.js';

type Flat = [number, number];

const WIDTH = 400;
const HEIGHT = 300;
const PADDING = 46;
/** More labels than this, or labels nearer than `NEAR`, would overlap; the table shows all distances. */
const MOST_LABELS = 8;
const NEAR = 30;

export class Projection {
  private redraw: () => void = () => {};

  /** The picture is seen from the side of `camera`. */
  constructor(
    private readonly svg: SVGSVGElement,
    private readonly camera: Camera,
  ) {
    svg.setAttribute('viewBox', `0 0 ${WIDTH} ${HEIGHT}`);
  }

  /** Draws again after the camera moved. */
  draw(): void {
    this.redraw();
  }

  setAnswer(scene: Scene, hulls: Partial<Record<Side, Hull>>, answer: Answer | undefined): void {
    this.redraw = () => this.show(scene, hulls, answer);
    this.redraw();
  }

  private show(scene: Scene, hulls: Partial<Record<Side, Hull>>, answer: Answer | undefined): void {
    this.svg.replaceChildren();
    if (!answer || !hulls.a || !hulls.b || answer.points.length === 0) return;
    const turned = (x: number, y: number) => new Vector3(x, y, 0).applyQuaternion(this.camera.quaternion);
    const plane = new Plane(answer.normal, turned(1, 0), turned(0, 1));
    const features = SIDES.map((side): Flat[] => {
      const pose = new Pose(scene.bodies[side]);
      return corners(hulls[side]!, answer.features[side]).map((p) => plane.of(pose.point(p)));
    });
    const points = answer.points.map(({ onA }) => plane.of(new Vector3(...onA)));
    const place = fit([...features.flat(), ...points]);
    SIDES.forEach((side, i) => this.shape(round(features[i]!.map(place)), `feature ${side}`));
    this.shape(round(points.map(place)), 'overlap');
    const placed = points.map(place);
    const middle = [0, 1].map((axis) => placed.reduce((sum, p) => sum + p[axis]!, 0) / placed.length) as Flat;
    placed.forEach((p, i) => {
      const isNear = (q: Flat) => Math.hypot(q[0] - p[0], q[1] - p[1]) < NEAR;
      const hasRoom = placed.length <= MOST_LABELS && !placed.slice(0, i).some(isNear);
      this.point(p, middle, hasRoom ? `${i + 1}: ${short(answer.points[i]!.distance)}` : `${i + 1}`);
    });
  }

  /** Draws a polygon, a segment or a dot. */
  private shape(outline: Flat[], kind: string): void {
    if (outline.length === 1) {
      this.add('circle', { class: kind, cx: outline[0]![0], cy: outline[0]![1], r: 5 });
    } else if (outline.length > 1) {
      this.add('polygon', { class: kind, points: outline.map((p) => p.join()).join(' ') });
    }
  }

  /** Draws a contact point, its label on the side away from the middle. */
  private point([x, y]: Flat, middle: Flat, text: string): void {
    this.add('circle', { class: 'point', cx: x, cy: y, r: 4 });
    const [right, down] = [x - middle[0], y - middle[1]];
    const away = Math.hypot(right, down);
    const [dx, dy] = away < 1 ? [0, -14] : [(11 * right) / away, (14 * down) / away];
    const anchor = Math.abs(dx) < 4 ? 'middle' : dx < 0 ? 'end' : 'start';
    this.add('text', { x: x + dx, y: y + dy + 4, 'text-anchor': anchor }).textContent = text;
  }

  private add(tag: string, attributes: Record<string, string | number>): SVGElement {
    const element = document.createElementNS('http://www.w3.org/2000/svg', tag);
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, `${value}`);
    this.svg.append(element);
    return element;
  }
}

/** The map from the plane to the picture that shows all points, centred. */
function fit(points: Flat[]): (p: Flat) => Flat {
  const ends = [0, 1].map((axis) => {
    const along = points.map((p) => p[axis]!);
    return [Math.min(...along), Math.max(...along)] as Flat;
  }) as [Flat, Flat];
  const [wide, high] = ends.map(([least, most]) => most - least) as Flat;
  const scale = Math.min((WIDTH - 2 * PADDING) / (wide || 1e-300), (HEIGHT - 2 * PADDING) / (high || 1e-300));
  const [x, y] = ends.map(([least, most]) => (least + most) / 2) as Flat;
  const finite = Math.min(scale, 1e300);
  return (p) => [WIDTH / 2 + (p[0] - x) * finite, HEIGHT / 2 - (p[1] - y) * finite];
}
