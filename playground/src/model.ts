// What the page shows: two bodies, and what is asked about them.

import type { FeatureKind, Outcome } from './generated/hullcast/v1/contacts_pb.js';

export type Side = 'a' | 'b';
export const SIDES: readonly Side[] = ['a', 'b'];

export type Triple = [number, number, number];
/** x, y, z, w. */
export type Quad = [number, number, number, number];

/** What a body is made of: a preset by its name, or points of the reader's own. */
export interface Shape {
  /** Of the preset; `OWN` for points that were pasted. */
  name: string;
  /** Three a point, hull frame. */
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

/** Everything that a link to a scene holds. */
export interface Scene {
  bodies: Record<Side, Body>;
  settings: Settings;
  /** Where the camera is, seen from what it looks at. */
  view: Triple;
}

/** A registered hull, as the server describes it. */
export interface Hull {
  id: Uint8Array;
  /** Three a vertex, hull frame. */
  vertices: number[];
  /** From the index that a point was registered with to its vertex. */
  vertexOf: Map<number, number>;
  /** Per face its vertices, anticlockwise seen from outside. */
  faces: number[][];
  /** Unit, outward, hull frame. */
  faceNormals: Triple[];
  centre: Triple;
  inradius: number;
  circumradius: number;
}

/** What a hull touches with, by the indices of the contract. */
export interface Feature {
  kind: FeatureKind;
  indices: [number, number];
}

export interface ContactPoint {
  onA: Triple;
  distance: number;
  /** Indices of two vertices of A, then of B; NONE inside a face. */
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
  /** Three vertices of A, three of B. */
  basis: number[];
  iterations: number;
  supportCalls: number;
  keptArea: number;
}

/** The answer to what was asked, and what is shown. */
export interface Contacts {
  answer: Answer;
  /** The same, but for a separated pair, whose numbers beyond the margin are asked for too. */
  shown: Answer;
  milliseconds: number;
}
