import { createHash } from "node:crypto";

/** A cloud of points to register: three numbers per point, in the hull's own frame. */
export interface Hull {
  vertices: number[];
  /** Three numbers; or absent for the centre of mass. */
  contractionPoint?: number[];
  simplification?: { maxVertices?: number; maxDeviation?: number };
  /** If absent, the server uses 1e-6. */
  planarity?: number;
}

/** The byte string that docs/identity.md defines. */
export function identityBytes(hull: Hull): Buffer {
  const { vertices, contractionPoint: point, simplification, planarity } = hull;
  const bytes = Buffer.alloc(40 + 8 * ((point?.length ?? 0) + vertices.length));
  let at = bytes.write("hullcast", "ascii");
  at = bytes.writeUInt32LE(planarity === undefined ? 1 : 2, at); // the format's version
  // -0.0 is written as 0.0.
  const numbers = (values: number[]) => values.forEach((value) => (at = bytes.writeDoubleLE(value + 0, at)));
  at = bytes.writeUInt8(point ? 1 : 0, at);
  numbers(point ?? []);
  at = bytes.writeUInt8(simplification ? 1 : 0, at);
  if (simplification) {
    const { maxVertices, maxDeviation } = simplification;
    at = bytes.writeUInt8(maxVertices === undefined ? 0 : 1, at);
    if (maxVertices !== undefined) at = bytes.writeUInt32LE(maxVertices, at);
    at = bytes.writeUInt8(maxDeviation === undefined ? 0 : 1, at);
    if (maxDeviation !== undefined) numbers([maxDeviation]);
  }
  if (planarity !== undefined) numbers([planarity]);
  at = bytes.writeUInt32LE(vertices.length / 3, at);
  numbers(vertices);
  return bytes.subarray(0, at);
}

/** The hull's id on every server: 32 bytes. */
export function hullId(hull: Hull): Buffer {
  return createHash("sha256").update(identityBytes(hull)).digest();
}
