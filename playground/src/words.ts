// Answers and errors as text.

import { Code, ConnectError } from '@connectrpc/connect';
import { FeatureKind, Flag, Outcome } from './generated/hullcast/v1/contacts_pb.js';
import { ErrorInfoSchema } from './generated/google/rpc/details_pb.js';
import { NONE, type Answer, type Contacts, type Feature } from './model.js';

const FLAGS: [Flag, string][] = [
  [Flag.ESTIMATED, 'Estimated: the projected features do not overlap, so the one contact point is an estimate.'],
  [Flag.COINCIDENT, 'Coincident: the centres coincide, so the growth scale is 0 and the normal is arbitrary.'],
  [Flag.GAP_OPEN, 'Gap open: the bracket is wider than the tolerance allows.'],
  [Flag.REDUCED, 'Reduced: some points were dropped because of “Most points”.'],
  [Flag.HULL_UNAVAILABLE, 'Hull unavailable: the server could not read a hull from its store; try again.'],
  [Flag.KINK, 'Kink: the gradient is not unique.'],
  [Flag.INVALID_BODY, 'Invalid body: a position or rotation is out of range.'],
];

export function flagsInWords(flags: number): string[] {
  return FLAGS.filter(([flag]) => flags & flag).map(([, words]) => words);
}

export function short(value: number): string {
  if (value === 0 || !Number.isFinite(value)) return value === Infinity ? '∞' : `${value}`;
  const size = Math.abs(value);
  const text = size < 1e-4 || size >= 1e6 ? value.toExponential(2) : `${Number(value.toPrecision(5))}`;
  return text.replaceAll('-', '−');
}

/** One or two sentences, for sighted readers and screen readers alike. */
export function summary({ answer, shown }: Contacts): string {
  const count = shown.points.length;
  const points = `${count} contact point${count === 1 ? '' : 's'}`;
  const alpha = `growth scale ${short(shown.alpha)}`;
  switch (answer.outcome) {
    case Outcome.CONTACT:
      return `Contact: the hulls ${met(shown)}; ${alpha}, ${points}.`;
    case Outcome.SEPARATED:
      return `Separated: certified farther apart than the margin. The numbers shown are for an infinite margin: ${alpha}.`;
    case Outcome.UNDECIDED:
      return 'Undecided: the iterations ended before the outcome was known.';
    default:
      return `Not answered. ${flagsInWords(answer.flags).join(' ')}`;
  }
}

function met({ alpha, separation }: Answer): string {
  if (alpha < 1) return `overlap by ${short(Math.abs(separation))} along the normal`;
  return `are apart by ${short(separation)} along the normal, within the margin`;
}

export function outcomeInWord(outcome: Outcome): string {
  return { 1: 'Contact', 2: 'Separated', 3: 'Undecided' }[outcome as number] ?? 'Not answered';
}

export function featureInWords({ kind, indices }: Feature): string {
  switch (kind) {
    case FeatureKind.FACE:
      return `face ${indices[0]}`;
    case FeatureKind.EDGE:
      return `edge ${indices[0]}–${indices[1]}`;
    case FeatureKind.VERTEX:
      return `vertex ${indices[0]}`;
    default:
      return 'none';
  }
}

/** The part of a hull that makes a contact point. */
export function elementInWords(first: number, second: number): string {
  if (first === NONE) return 'inside its face';
  return first === second ? `vertex ${first}` : `edge ${first}–${second}`;
}

export function errorInWords(error: unknown): string {
  if (!(error instanceof ConnectError)) return error instanceof Error ? error.message : String(error);
  const info = error.findDetails(ErrorInfoSchema)[0];
  const field = info?.metadata.field ? ` (${info.metadata.field})` : '';
  switch (error.code) {
    case Code.Unauthenticated:
    case Code.PermissionDenied:
      return `The server requires a token: ${error.rawMessage}.`;
    case Code.Unavailable:
      return `The server is too busy or is stopping: ${error.rawMessage}.`;
    case Code.Unknown:
    case Code.Internal:
      return `The server cannot be reached, or sent an answer that this page does not understand: ${error.rawMessage}.`;
    default:
      return `The server refused the request${info ? ` (${info.reason})` : ''}: ${error.rawMessage}${field}.`;
  }
}

export function asksForToken(error: unknown): boolean {
  return error instanceof ConnectError && [Code.Unauthenticated, Code.PermissionDenied].includes(error.code);
}
