export type Vector = [number, number, number];
/** In the order x, y, z, w. */
export type Quaternion = [number, number, number, number];

export const add = (a: Vector, b: Vector): Vector => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const times = (a: Vector, s: number): Vector => [a[0] * s, a[1] * s, a[2] * s];
export const minus = (a: Vector, b: Vector): Vector => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const dot = (a: Vector, b: Vector): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const norm = (a: Vector): number => Math.sqrt(dot(a, a));
export const cross = (a: Vector, b: Vector): Vector => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];

export function rotate([x, y, z, w]: Quaternion, v: Vector): Vector {
  const axis: Vector = [x, y, z];
  const s = 2 / (dot(axis, axis) + w * w);
  const turned = cross(axis, v);
  return add(add(v, times(turned, w * s)), times(cross(axis, turned), s));
}

export const inverse = ([x, y, z, w]: Quaternion): Quaternion => [-x, -y, -z, w];

/** The distance from a point to a convex polygon in space. */
export function distanceToPolygon(p: Vector, corners: Vector[]): number {
  const first = corners[0]!;
  const sides = corners.map((start, i) => ({ start, side: minus(corners[(i + 1) % corners.length]!, start) }));
  const normal = sides
    .map(({ start, side }) => cross(minus(start, first), side))
    .reduce(add);
  if (sides.every(({ start, side }) => dot(cross(normal, side), minus(p, start)) >= 0)) {
    return Math.abs(dot(minus(p, first), normal)) / norm(normal);
  }
  const toSides = sides.map(({ start, side }) => {
    const t = dot(minus(p, start), side) / dot(side, side);
    return norm(minus(minus(p, start), times(side, Math.max(0, Math.min(1, t)))));
  });
  return Math.min(...toSides);
}
