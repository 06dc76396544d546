// Hulls in the world frame, and the contact plane.

import { Quaternion, Vector3 } from 'three';
import { FeatureKind } from './generated/hullcast/v1/contacts_pb.js';
import type { Answer, Body, Feature, Hull, Triple } from './model.js';

/** A body's pose; maps points of its hull to the world. */
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

/** The vertices of a feature in the hull's frame; those of a face are anticlockwise seen from outside. */
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
  /** The vertices, the lower index first. */
  ends: [number, number];
  /** The faces on both sides. */
  faces: [number, number];
}

/** The edges of the hull, each once. */
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
 * The point where the two hulls touch when grown by alpha: `pA + sum l_i a_i`. The weights `l` solve
 * `sum l_i (a_i - b_i) = pB - pA` over the basis's three pairs of vertices, all relative to the contraction points.
 * Undefined if the three pairs are degenerate.
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

/** 2D coordinates on a plane perpendicular to the normal. */
export class Plane {
  private readonly right: Vector3;
  private readonly up: Vector3;

  /** Seen from the camera's side of the plane: right in the picture is right on the plane. */
  constructor(normal: Triple, cameraRight: Vector3, cameraUp: Vector3) {
    const n = new Vector3(...normal);
    const across = (direction: Vector3) => direction.clone().addScaledVector(n, -n.dot(direction));
    const [right, up] = [across(cameraRight), across(cameraUp)];
    // Use the longer of the two projections, which is the more accurate.
    const isRight = right.lengthSq() >= up.lengthSq();
    this.right = isRight ? right.normalize() : n.clone().cross(up).normalize();
    if (!isRight && this.right.dot(cameraRight) < 0) this.right.negate();
    this.up = n.clone().cross(this.right);
    if (this.up.dot(cameraUp) < 0) this.up.negate();
  }

  /** The coordinates to the right and up. */
  of(p: Vector3): [number, number] {
    return [p.dot(this.right), p.dot(this.up)];
  }
}

/** Points in anticlockwise order about their mean, the order of a convex outline. */
export function round(points: [number, number][]): [number, number][] {
  const middle = [0, 1].map((i) => points.reduce((sum, p) => sum + p[i]!, 0) / points.length);
  const angle = ([x, y]: [number, number]) => Math.atan2(y - middle[1]!, x - middle[0]!);
  return [...points].sort((p, q) => angle(p) - angle(q));
}
