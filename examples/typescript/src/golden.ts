import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";

import { Flag } from "./generated/hullcast/v1/Flag.js";
import { Outcome } from "./generated/hullcast/v1/Outcome.js";
import type { QueryContactsRequest } from "./generated/hullcast/v1/QueryContactsRequest.js";
import type { QueryContactsResponse__Output } from "./generated/hullcast/v1/QueryContactsResponse.js";
import { type Hull, hullId } from "./identity.js";
import { add, distanceToPolygon, dot, inverse, minus, norm, type Quaternion, rotate, times, type Vector } from "./vector.js";

/** A hull at a pose. */
interface Side {
  vertices: Vector[];
  contraction_point: Vector;
  position: Vector;
  rotation: Quaternion;
}

/** A case of tests/golden/contacts.json, which tests/golden/README.md describes. */
export interface Case {
  name: string;
  a: Side;
  b: Side;
  margin: number | null;
  outcome: "CONTACT" | "SEPARATED";
  alpha_below: number;
  alpha_above: number;
  alpha_budget: number;
  length_budget: number;
  patch: Vector[] | null;
  patch_budget: number;
}

export interface IdentityVector {
  name: string;
  vertices: number[];
  contraction_point?: number[];
  max_vertices?: number;
  max_deviation?: number;
  planarity?: number;
  id: string;
  bytes?: string;
}

export function readCases(root: string): Case[] {
  const file = JSON.parse(readFileSync(join(root, "tests/golden/contacts.json"), "utf8"));
  assert.equal(file.format, "hullcast.golden.v1");
  return file.cases;
}

export function readIdentityVectors(root: string): IdentityVector[] {
  const block = /```json\n([^]*?)```/.exec(readFileSync(join(root, "docs/identity.md"), "utf8"));
  return JSON.parse(block![1]!);
}

export const hullOf = (side: Side): Hull => ({
  vertices: side.vertices.flat(),
  contractionPoint: side.contraction_point,
});

/** The columns of a request that checks edit; in `Request` they are always present. */
interface Columns {
  hullIds: Buffer[];
  bodyHulls: number[];
  positions: number[];
  rotations: number[];
  pairs: number[];
}
export type Request = Omit<QueryContactsRequest, keyof Columns> & Columns;

export function requestOf(golden: Case): Request {
  const ids = [golden.a, golden.b].map((side) => hullId(hullOf(side)));
  const same = ids[0]!.equals(ids[1]!); // each hull is listed once
  return {
    hullIds: same ? ids.slice(1) : ids,
    bodyHulls: same ? [0, 0] : [0, 1],
    positions: [...golden.a.position, ...golden.b.position],
    rotations: [...golden.a.rotation, ...golden.b.rotation],
    pairs: [0, 1],
    margin: golden.margin ?? Infinity,
    outputs: ["OUTPUT_ALPHA", "OUTPUT_NORMAL", "OUTPUT_POINTS"],
  };
}

/** The largest n . (v - contraction point) over the vertices v; n is in the world frame. */
function support(side: Side, n: Vector): number {
  const local = rotate(inverse(side.rotation), n);
  return Math.max(...side.vertices.map((v) => dot(local, minus(v, side.contraction_point))));
}

const within = (what: string, difference: number, budget: number) =>
  assert.ok(Math.abs(difference) <= budget, `${what} is off by ${difference}, allowed is ${budget}`);

/** Compares the answer for the case's one pair with the exact one. */
export function check(golden: Case, answer: QueryContactsResponse__Output): void {
  assert.equal(answer.outcomes[0], Outcome[`OUTCOME_${golden.outcome}`]);
  const [alpha, lower, upper] = [answer.alphas[0]!, answer.alphaLowers[0]!, answer.alphaUppers[0]!];
  assert.ok(lower <= golden.alpha_below && upper >= golden.alpha_above, `alpha is not in [${lower}, ${upper}]`);
  if (golden.outcome === "SEPARATED") return;
  // Twice the budgets, because the numbers computed here are rounded too.
  within("alpha", alpha - golden.alpha_below, 2 * golden.alpha_budget);
  const { a, b } = golden;
  const n = answer.normals as Vector;
  within("the normal's length", norm(n) - 1, 1e-15);
  const centres = minus(
    add(minus(b.position, a.position), rotate(b.rotation, b.contraction_point)),
    rotate(a.rotation, a.contraction_point),
  );
  const reach = support(a, n) + support(b, times(n, -1));
  assert.ok(golden.alpha_below - dot(n, centres) / reach <= 2 * golden.alpha_budget, `${n} is not optimal`);
  within("the separation", answer.separations[0]! - (dot(n, centres) - reach), 2 * golden.length_budget);
  checkPoints(golden, answer);
}

function checkPoints(golden: Case, answer: QueryContactsResponse__Output): void {
  const count = answer.pointCounts[0]!;
  assert.ok(count > 0);
  assert.deepEqual([answer.distances.length, answer.witnessAs.length], [count, 3 * count]);
  if (golden.patch === null) return;
  const found = Array.from({ length: count }, (_, i) => answer.witnessAs.slice(3 * i, 3 * i + 3) as Vector);
  assert.ok(count >= 3 && !(answer.flags[0]! & Flag.FLAG_ESTIMATED));
  const far = [
    ...found.map((p) => distanceToPolygon(p, golden.patch!)),
    ...golden.patch.map((p) => distanceToPolygon(p, found)),
  ];
  within("the patch", Math.max(...far), golden.patch_budget);
}
