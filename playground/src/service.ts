// The gRPC-web calls of the page.

import { createClient, type Interceptor } from '@connectrpc/connect';
import { createGrpcWebTransport } from '@connectrpc/connect-web';
import {
  ContactService,
  Flag,
  Outcome,
  Output,
  Solver,
  type QueryContactsResponse,
} from './generated/hullcast/v1/contacts_pb.js';
import { HullService, type HullRecord } from './generated/hullcast/v1/hulls_pb.js';
import type { Answer, Contacts, Feature, Hull, Quad, Scene, Settings, Shape, Triple } from './model.js';
import { SIDES } from './model.js';

const TIMEOUT_MS = 10_000;

/**
 * How far the vertices of one face may lie from one plane, as a fraction of the circumradius. Pasted points are rounded
 * like those of mesh files, and rounding would otherwise split a face into many. This is the default of the Python
 * client and of the command line, which was measured (docs/tradeoff.md), so that all of them give a shape the same id.
 */
const PLANARITY = 1e-3;

let token = '';

/** Sets the token for servers that require one. Only this page keeps it, until it is closed. */
export function setToken(given: string): void {
  token = given;
}

const authorize: Interceptor = (next) => (request) => {
  if (token) request.header.set('authorization', `Bearer ${token}`);
  return next(request);
};

const transport = createGrpcWebTransport({
  baseUrl: location.origin,
  interceptors: [authorize],
  defaultTimeoutMs: TIMEOUT_MS,
});
const hulls = createClient(HullService, transport);
const contacts = createClient(ContactService, transport);

/** The points have no valid hull; the message is the server's reason. */
export class HullRefused extends Error {}

/** Registers a shape and reads the hull that the server made of it. */
export async function register(shape: Shape): Promise<Hull> {
  const { results } = await hulls.registerHulls({ hulls: [{ vertices: shape.points, planarity: PLANARITY }] });
  const result = results[0]?.result;
  if (result?.case === 'error') throw new HullRefused(`${result.value.message} (${result.value.reason}).`);
  if (result?.case !== 'hull') throw new Error('The server’s answer is empty.');
  const paths = ['info', 'vertices', 'faces'];
  const records = await hulls.getHulls({ ids: [result.value.id], fieldMask: { paths } });
  return hullOf(records.hulls[0]!);
}

function hullOf(record: HullRecord): Hull {
  const { info, vertexIndices, faceOffsets, faceVertices, faceNormals } = record;
  const vertexOf = new Map(vertexIndices.map((registered, vertex) => [registered, vertex]));
  const faces = faceOffsets
    .slice(1)
    .map((end, i) => faceVertices.slice(faceOffsets[i], end).map((registered) => vertexOf.get(registered)!));
  return {
    id: record.id,
    vertices: record.vertices,
    vertexOf,
    faces,
    faceNormals: faces.map((_, i) => faceNormals.slice(3 * i, 3 * i + 3) as Triple),
    centre: info!.contractionPoint as Triple,
    inradius: info!.inradius,
    circumradius: info!.circumradius,
  };
}

/** The server no longer has a hull, so it must be registered again. */
export class HullMissing extends Error {
  constructor() {
    super('The server no longer has a hull; reload the page.');
  }
}

/** Queries the contacts of A with B. */
export async function query(scene: Scene, registered: Hull[]): Promise<Contacts> {
  const started = performance.now();
  const answer = await ask(scene, registered, scene.settings.margin);
  // The numbers of a separated pair are only bounds, so show the answer at an infinite margin.
  const shown = answer.outcome === Outcome.SEPARATED ? await ask(scene, registered, Infinity) : answer;
  return { answer, shown, milliseconds: performance.now() - started };
}

async function ask(scene: Scene, registered: Hull[], margin: number): Promise<Answer> {
  const bodies = SIDES.map((side) => scene.bodies[side]);
  const same = String(registered[0]!.id) === String(registered[1]!.id);
  const response = await contacts.queryContacts({
    hullIds: registered.slice(0, same ? 1 : 2).map(({ id }) => id),
    bodyHulls: [0, same ? 0 : 1],
    positions: bodies.flatMap(({ position }) => position),
    rotations: bodies.flatMap(({ rotation }) => unit(rotation)),
    pairs: [0, 1],
    margin,
    accuracy: accuracy(scene.settings),
    outputs: [Output.ALPHA, Output.NORMAL, Output.POINTS, Output.FEATURES, Output.BASES, Output.DIAGNOSTICS],
  });
  if (response.flags[0]! & Flag.UNKNOWN_HULL) throw new HullMissing();
  return answerOf(response);
}

function accuracy(settings: Settings) {
  const { featureAngle, maxPoints, relativeTolerance } = settings;
  const solver = settings.solver === 'gjk' ? Solver.GJK_RAY_CAST : Solver.PORTAL;
  return { solver, featureAngle, maxPoints, relativeTolerance };
}

/** The quaternion normalised, unless its norm is already near 1: a link may contain any rotation. */
function unit(q: Quad): Quad {
  const norm = Math.hypot(...q);
  return Math.abs(norm - 1) < 1e-4 || norm === 0 ? q : (q.map((value) => value / norm) as Quad);
}

/** The answer about the response's only pair. */
function answerOf(response: QueryContactsResponse): Answer {
  const { featureKinds, featureIndices, pointIds, witnessAs } = response;
  const feature = (i: number): Feature => ({
    kind: featureKinds[i]!,
    indices: featureIndices.slice(2 * i, 2 * i + 2) as [number, number],
  });
  return {
    outcome: response.outcomes[0]!,
    flags: response.flags[0]!,
    alpha: response.alphas[0]!,
    lower: response.alphaLowers[0]!,
    upper: response.alphaUppers[0]!,
    separation: response.separations[0]!,
    normal: response.normals as Triple,
    points: response.distances.map((distance, i) => ({
      onA: witnessAs.slice(3 * i, 3 * i + 3) as Triple,
      distance,
      id: pointIds.slice(4 * i, 4 * i + 4) as [number, number, number, number],
    })),
    features: { a: feature(0), b: feature(1) },
    basis: response.bases,
    iterations: response.iterations[0]!,
    supportCalls: response.supportCalls[0]!,
    keptArea: response.keptAreas[0]!,
  };
}
