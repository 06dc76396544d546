// The data of the page: two bodies, and the query about them.

import type { FeatureKind, Outcome } from './generated/hullcast/v1/contacts_pb.js';

export type Side = 'a' | 'b';
export const SIDES: readonly Side[] = ['a', 'b'];

export type Triple = [number, number, number];
/** A quaternion x, y, z, w. */
export type Quad = [number, number, number, number];

/** The points of a body: a preset by name, or the reader's own. */
export interface Shape {
  /** The preset's name, or `OWN` for pasted points. */
  name: string;
  /** Three coordinates per point, hull frame. */
  points: number[];
}

export const OWN = 'own';

export interface Body {
  shape: Shape;
  position: Triple;
  rotation: Quad;
}

export interface Settings {
  margin: number;
  featureAngle: number;
  maxPoints: number;
  relativeTolerance: number;
  solver: 'portal' | 'gjk';
}

/** Everything that a link to a scene contains. */
export interface Scene {
  bodies: Record<Side, Body>;
  settings: Settings;
  /** The camera's position relative to the point that it looks at. */
  view: Triple;
}

/** A registered hull, as the server describes it. */
export interface Hull {
  id: Uint8Array;
  /** Three coordinates per vertex, hull frame. */
  vertices: number[];
  /** Maps the index of a registered point to its vertex. */
  vertexOf: Map<number, number>;
  /** The vertices of each face, anticlockwise seen from outside. */
  faces: number[][];
  /** Outward unit normals, hull frame. */
  faceNormals: Triple[];
  centre: Triple;
  inradius: number;
  circumradius: number;
}

/** The feature with which a hull touches, in the indices of the contract. */
export interface Feature {
  kind: FeatureKind;
  indices: [number, number];
}

export interface ContactPoint {
  onA: Triple;
  distance: number;
  /** The indices of two vertices of A, then of B; NONE if the point is inside a face. */
  id: [number, number, number, number];
}

export const NONE = 0xffffffff;

/** The server's answer for the pair. */
export interface Answer {
  outcome: Outcome;
  flags: number;
  alpha: number;
  lower: number;
  upper: number;
  separation: number;
  normal: Triple;
  points: ContactPoint[];
  features: Record<Side, Feature>;
  /** Three vertices of A, then three of B. */
  basis: number[];
  iterations: number;
  supportCalls: number;
  keptArea: number;
}

/** The answer to the query, and the answer that is shown. */
export interface Contacts {
  answer: Answer;
  /** Equal to `answer`, except for a separated pair: then the answer at an infinite margin. */
  shown: Answer;
  milliseconds: number;
}
