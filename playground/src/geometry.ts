// Hulls in the world, and the contact plane.

import { Quaternion, Vector3 } from 'three';
import { FeatureKind } from './generated/hullcast/v1/contacts_pb.js';
import type { Answer, Body, Feature, Hull, Triple } from './model.js';

/** A body's pose, to take points of its hull to the world. */
export class Pose {
  readonly position: Vector3;
  readonly rotation: Quaternion;

  constructor(body: Body) {
    this.position = new Vector3(...body.position);
    this.rotation = new Quaternion(...body.rotation).normalize();
  }

  point(p: Vector3): Vector3 {
    return p.applyQuaternion(this.rotation).add(this.position);
  }
}

export function vertex(hull: Hull, i: number): Vector3 {
  return new Vector3().fromArray(hull.vertices, 3 * i);
}

/** The vertices of a feature, hull frame; those of a face anticlockwise seen from outside. */
export function corners(hull: Hull, { kind, indices }: Feature): Vector3[] {
  const registered = (index: number) => vertex(hull, hull.vertexOf.get(index) ?? 0);
  switch (kind) {
    case FeatureKind.FACE:
      return (hull.faces[indices[0]] ?? []).map((i) => vertex(hull, i));
    case FeatureKind.EDGE:
      return indices.map(registered);
    case FeatureKind.VERTEX:
      return [registered(indices[0])];
    default:
      return [];
  }
}

export interface Edge {
  /** Vertices, lower first. */
  ends: [number, number];
  /** The faces on its two sides. */
  faces: [number, number];
}

/** Each edge once. */
export function edges(hull: Hull): Edge[] {
  const found = new Map<string, Edge>();
  hull.faces.forEach((face, f) =>
    face.forEach((from, i) => {
      const to = face[(i + 1) % face.length]!;
      const ends: [number, number] = [Math.min(from, to), Math.max(from, to)];
      const edge = found.get(ends.join());
      if (edge) edge.faces[1] = f;
      else found.set(ends.join(), { ends, faces: [f, f] });
    }),
  );
  return [...found.values()];
}

/**
 * Where the two hulls, grown to alpha, touch: `pA + sum l_i a_i`, with `l` from
 * `sum l_i (a_i - b_i) = pB - pA` over the basis' three pairs of vertices, all about the
 * contraction points. None where the three are degenerate.
 */
export function touch(answer: Answer, a: [Hull, Pose], b: [Hull, Pose]): Vector3 | undefined {
  const about = ([hull, pose]: [Hull, Pose], registered: number) => {
    const i = hull.vertexOf.get(registered);
    return i === undefined ? undefined : vertex(hull, i).sub(new Vector3(...hull.centre)).applyQuaternion(pose.rotation);
  };
  const as = answer.basis.slice(0, 3).map((i) => about(a, i));
  const bs = answer.basis.slice(3, 6).map((i) => about(b, i));
  if (as.length < 3 || [...as, ...bs].includes(undefined)) return undefined;
  const [u, v, w] = as.map((p, i) => p!.clone().sub(bs[i]!)) as [Vector3, Vector3, Vector3];
  const centre = a[1].point(new Vector3(...a[0].centre));
  const d = b[1].point(new Vector3(...b[0].centre)).sub(centre);
  const volume = (p: Vector3, q: Vector3, r: Vector3) => p.dot(q.clone().cross(r));
  const whole = volume(u, v, w);
  const shares = [volume(d, v, w) / whole, volume(u, d, w) / whole, volume(u, v, d) / whole];
  if (!shares.every(Number.isFinite)) return undefined;
  as.forEach((p, i) => centre.addScaledVector(p!, shares[i]!));
  return centre;
}

/** Coordinates on a plane across the normal. */
export class Plane {
  private readonly right: Vector3;
  private readonly up: Vector3;

  /** As seen from the side that the camera is on: its right stays right. */
  constructor(normal: Triple, cameraRight: Vector3, cameraUp: Vector3) {
    const n = new Vector3(...normal);
    const across = (direction: Vector3) => direction.clone().addScaledVector(n, -n.dot(direction));
    const [right, up] = [across(cameraRight), across(cameraUp)];
    // Of the two the one that says more of the plane.
    const isRight = right.lengthSq() >= up.lengthSq();
    this.right = isRight ? right.normalize() : n.clone().cross(up).normalize();
    if (!isRight && this.right.dot(cameraRight) < 0) this.right.negate();
    this.up = n.clone().cross(this.right);
    if (this.up.dot(cameraUp) < 0) this.up.negate();
  }

  /** Right and up. */
  of(p: Vector3): [number, number] {
    return [p.dot(this.right), p.dot(this.up)];
  }
}

/** Points round their middle, anticlockwise: a convex outline's order. */
export function round(points: [number, number][]): [number, number][] {
  const middle = [0, 1].map((i) => points.reduce((sum, p) => sum + p[i]!, 0) / points.length);
  const angle = ([x, y]: [number, number]) => Math.atan2(y - middle[1]!, x - middle[0]!);
  return [...points].sort((p, q) => angle(p) - angle(q));
}
