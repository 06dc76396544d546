import assert from "node:assert/strict";
import { readFileSync } from "node:fs";

import * as grpc from "@grpc/grpc-js";

import { Client, refusal } from "./client.js";
import { Flag } from "./generated/hullcast/v1/Flag.js";
import { Outcome } from "./generated/hullcast/v1/Outcome.js";
import { type Case, check, hullOf, readIdentityVectors, type Request, requestOf } from "./golden.js";
import { hullId, identityBytes } from "./identity.js";

export function identities(root: string): number {
  const vectors = readIdentityVectors(root);
  for (const vector of vectors) {
    const { vertices, contraction_point: contractionPoint, planarity } = vector;
    const { max_vertices: maxVertices, max_deviation: maxDeviation } = vector;
    const simplified = maxVertices !== undefined || maxDeviation !== undefined;
    const simplification = simplified ? { maxVertices, maxDeviation } : undefined;
    const hull = { vertices, contractionPoint, simplification, planarity };
    assert.equal(hullId(hull).toString("hex"), vector.id, vector.name);
    assert.equal(identityBytes(hull).toString("hex"), vector.bytes ?? identityBytes(hull).toString("hex"));
  }
  return vectors.length;
}

/** Queries every case with both solvers. */
export async function answers(client: Client, cases: Case[]): Promise<number> {
  let count = 0;
  for (const golden of cases) {
    await client.register(hullOf(golden.a), hullOf(golden.b));
    for (const solver of ["SOLVER_PORTAL", "SOLVER_GJK_RAY_CAST"] as const) {
      try {
        check(golden, await client.query({ ...requestOf(golden), accuracy: { solver } }));
      } catch (cause) {
        throw new Error(`${golden.name} with ${solver}`, { cause });
      }
      count += 1;
    }
  }
  return count;
}

/** Asserts that the call fails, with this code, reason and field. */
async function refused(call: Promise<unknown>, wanted: string): Promise<void> {
  const said = await call.then(() => "no error", refusal);
  assert.equal(said.trim(), wanted);
}

export async function errors(client: Client, golden: Case): Promise<number> {
  const outside = { ...requestOf(golden), pairs: [0, 1, 1, 7] };
  await refused(client.query(outside), "INVALID_ARGUMENT hullcast/INDEX_OUT_OF_RANGE pairs[3]");
  const short = { ...requestOf(golden), rotations: [0, 0, 0, 1, 0, 0, 0] };
  await refused(client.query(short), "INVALID_ARGUMENT hullcast/LENGTH_MISMATCH rotations");
  await refused(client.stream([{ inherit: true }]), "INVALID_ARGUMENT hullcast/NOTHING_TO_INHERIT inherit");
  // One invalid hull does not affect the other.
  const flat = { vertices: [0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0] };
  const { results } = await client.registerHulls({ hulls: [flat, hullOf(golden.a)] });
  assert.equal(results[0]!.error?.reason, "COPLANAR");
  assert.equal(results[0]!.error?.field, "vertices");
  assert.ok(results[1]!.hull);
  // Nor does an unknown hull affect the pairs of other hulls.
  const known = requestOf(golden);
  const unknown = {
    ...known,
    hullIds: [...known.hullIds, Buffer.alloc(32)],
    bodyHulls: [...known.bodyHulls, known.hullIds.length],
    positions: [...known.positions, 0, 0, 0],
    rotations: [...known.rotations, 0, 0, 0, 1],
    pairs: [0, 1, 0, 2],
  };
  const answer = await client.query(unknown);
  assert.deepEqual([...answer.outcomes], [Outcome.OUTCOME_CONTACT, Outcome.OUTCOME_INVALID]);
  assert.equal(answer.flags[1], Flag.FLAG_UNKNOWN_HULL);
  assert.deepEqual(answer.missingHulls, [known.hullIds.length]);
  return 5;
}

/**
 * Sends only poses after a stream's first message. Each answer must equal that of the full request
 * with the previous bases as warm starts.
 */
export async function steps(client: Client, golden: Case): Promise<number> {
  const full: Request = requestOf(golden);
  full.outputs = [...full.outputs!, "OUTPUT_BASES"];
  const positions = Array.from({ length: 8 }, (_, step) =>
    full.positions.map((x, i) => (i === 3 ? x + 0.01 * step : x)),
  );
  const poses = positions.map((positions, requestId) => ({ requestId, inherit: true, positions, rotations: full.rotations }));
  const answers = await client.stream([full, ...poses.slice(1)]);
  for (const [step, answer] of answers.entries()) {
    const warmStarts = answers[step - 1]?.bases;
    const whole = await client.query({ ...full, requestId: step, positions: positions[step], warmStarts });
    assert.equal(answer.alphas.length, 1);
    assert.deepEqual(answer, whole, `step ${step}`);
  }
  return answers.length;
}

/**
 * Makes four steps in which the server finds the pairs: all bodies, none moved, one moved away, and one
 * removed while a new one comes. The matches say what became of the pair of the step before.
 */
export async function loops(client: Client, golden: Case): Promise<number> {
  const none = 2 ** 32 - 1;
  const named: Request = requestOf(golden);
  const all: Request = { ...named, find: true, pairs: [], outputs: [...named.outputs!, "OUTPUT_MATCHES"] };
  const [x, ...rest] = named.positions.slice(3, 6);
  const answers = await client.stream([
    all,
    { inherit: true },
    { inherit: true, moved: [1], positions: [x! + 1e6, ...rest], rotations: named.rotations.slice(4, 8) },
    { ...all, previousBodies: [0, none] },
  ]);
  assert.deepEqual(answers[0]!.alphas, (await client.query(named)).alphas);
  const found = answers.map(({ pairs, previousPairs, endedPairs }) => [pairs, previousPairs, endedPairs]);
  assert.deepEqual(found, [
    [[0, 1], [none], []],
    [[0, 1], [0], []],
    [[], [], [0, 1]],
    [[0, 1], [none], []],
  ]);
  return answers.length;
}

/** Sends a request that takes many times its deadline. */
export async function deadlines(client: Client, golden: Case): Promise<number> {
  const pairs = Array.from({ length: 2 * 131072 }, (_, i) => i % 2);
  const call = client.query({ ...requestOf(golden), pairs }, { deadline: Date.now() + 1 });
  assert.match(await call.then(() => "no error", refusal), /^DEADLINE_EXCEEDED/);
  return 1;
}

/**
 * Calls a server with TLS and tokens. The client must trust its authority and send a token, and the
 * token's role must allow the call.
 */
export async function secured(args: string[], golden: Case): Promise<number> {
  const [target, authority, registers, queries] = args;
  if (!target || !authority || !registers || !queries) return 0;
  const tls = grpc.credentials.createSsl(readFileSync(authority));
  const sending = (token: string) =>
    grpc.credentials.combineChannelCredentials(
      tls,
      grpc.credentials.createFromMetadataGenerator((_, callback) => {
        const metadata = new grpc.Metadata();
        metadata.set("authorization", `Bearer ${token}`);
        callback(null, metadata);
      }),
    );
  const attempts = [
    { credentials: grpc.credentials.createSsl(), wanted: /^UNAVAILABLE/ },
    { credentials: tls, wanted: /^UNAUTHENTICATED/ },
    { credentials: sending("none"), wanted: /^UNAUTHENTICATED/ },
    { credentials: sending(queries), wanted: /^PERMISSION_DENIED/ },
    { credentials: sending(registers), wanted: /^OK/ },
  ];
  for (const { credentials, wanted } of attempts) {
    const client = new Client(target, credentials);
    assert.match(await client.register(hullOf(golden.a)).then(() => "OK", refusal), wanted);
    client.close();
  }
  const client = new Client(target, sending(queries));
  check(golden, await client.query(requestOf(golden)));
  client.close();
  return attempts.length + 1;
}
