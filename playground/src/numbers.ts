// Shows the answer as text. The element of each number holds all its digits in `value`.

import { Outcome } from './generated/hullcast/v1/contacts_pb.js';
import type { Answer, Contacts } from './model.js';
import { elementInWords, featureInWords, flagsInWords, outcomeInWord, short, summary } from './words.js';

export function element<T extends Element = HTMLElement>(id: string): T {
  return document.getElementById(id) as unknown as T;
}

/** After this time without a change, the status is announced to screen readers. */
const STILL_MS = 400;

export function showNumbers(contacts: Contacts): void {
  const { answer, shown } = contacts;
  datum('outcome', outcomeInWord(answer.outcome), Outcome[answer.outcome] ?? '');
  number('alpha', shown.alpha);
  number('lower', shown.lower);
  number('upper', shown.upper);
  number('separation', shown.separation);
  (['x', 'y', 'z'] as const).forEach((axis, i) => number(`normal-${axis}`, shown.normal[i]!));
  element('width').textContent = `${short(shown.upper - shown.lower)} wide`;
  for (const side of ['a', 'b'] as const) {
    element(`feature-${side}`).textContent = featureInWords(shown.features[side]);
  }
  const milliseconds = contacts.milliseconds.toFixed(1);
  element('effort').textContent =
    `${shown.iterations} iterations, ${shown.supportCalls} support calls; ${milliseconds} ms with the network`;
  showBracket(shown);
  showPoints(shown);
  const [a, b] = [featureInWords(shown.features.a), featureInWords(shown.features.b)];
  element('gauss-words').textContent = `n falls on ${a} of A and ${b} of B; the ring is the feature angle.`;
  const kept = shown.keptArea < 1 ? ` The points span ${(100 * shown.keptArea).toFixed(0)} % of the patch.` : '';
  element('plane-words').textContent =
    `${a} of A and ${b} of B along n; corners of their intersection with signed distances.${kept}`;
  say(summary(contacts), flagsInWords(answer.flags | shown.flags));
}

let timer = 0;

/** Shows the status and flags. Screen readers do not announce the text while it keeps changing. */
function say(words: string, flags: string[]): void {
  const status = element('status');
  status.setAttribute('aria-live', 'off');
  status.textContent = words;
  element('flags').replaceChildren(
    ...flags.map((text) => Object.assign(document.createElement('li'), { textContent: text })),
  );
  clearTimeout(timer);
  timer = setTimeout(() => {
    status.setAttribute('aria-live', 'polite');
    status.textContent = '';
    status.textContent = words;
  }, STILL_MS);
}

function number(id: string, value: number): void {
  datum(id, short(value), `${value}`);
}

function datum(id: string, text: string, value: string): void {
  const data = element<HTMLDataElement>(id);
  data.value = value;
  data.textContent = text;
}

function showPoints({ points }: Answer): void {
  const rows = points.map(({ onA, distance, id }, i) => {
    const row = document.createElement('tr');
    const cell = (...content: (string | Node)[]) => {
      row.append(Object.assign(document.createElement('td'), {}));
      row.lastElementChild!.append(...content);
    };
    cell(`${i + 1}`);
    cell(data(distance));
    cell(...onA.flatMap((value, axis) => (axis > 0 ? [', ', data(value)] : [data(value)])));
    cell(`A: ${elementInWords(id[0], id[1])}, B: ${elementInWords(id[2], id[3])}`);
    return row;
  });
  element('points').replaceChildren(...rows);
}

function data(value: number): HTMLDataElement {
  const element = document.createElement('data');
  element.value = `${value}`;
  element.textContent = short(value);
  return element;
}

/** Draws the bracket on a line from 0 to 2; values beyond the ends are drawn at the ends. */
function showBracket({ lower, upper }: Answer): void {
  const x = (value: number) => 12 + 148 * Math.min(Math.max(value, 0), 2);
  const [from, to] = [x(lower), x(upper)];
  const middle = (from + to) / 2;
  element<SVGSVGElement>('bracket').replaceChildren(
    drawn('line', { x1: 12, x2: 308, y1: 26, y2: 26 }),
    ...[0, 1, 2].map((value) => drawn('line', { x1: x(value), x2: x(value), y1: 20, y2: 32 })),
    drawn('rect', { class: 'interval', x: from, width: Math.max(to - from, 0.5), y: 22, height: 8 }),
    drawn('path', { class: 'interval', d: `M${middle} 20l-5-9h10z` }),
    drawn('text', { x: x(0), y: 46 }, '0'),
    drawn('text', { x: x(1), y: 46 }, '1: touching'),
    drawn('text', { x: x(2), y: 46 }, '2'),
  );
}

function drawn(tag: string, attributes: Record<string, string | number>, text = ''): SVGElement {
  const element = document.createElementNS('http://www.w3.org/2000/svg', tag);
  for (const [name, value] of Object.entries(attributes)) {
    element.setAttribute(name, Number.isNaN(value) ? '0' : `${value}`);
  }
  element.textContent = text;
  return element;
}
