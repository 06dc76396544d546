// Converts a scene to the part of the page's address after the #, and back.

import { OWN, SIDES, type Body, type Quad, type Scene, type Settings, type Triple } from './model.js';
import { preset } from './shapes.js';

/** The scene with which the page starts. */
export function firstScene(): Scene {
  return {
    bodies: {
      a: { shape: preset('plate')!, position: [0, 0, 0], rotation: [0, 0, 0, 1] },
      b: { shape: preset('prism')!, position: [0.55, -0.3, 0.5], rotation: [0.003966, -0.000522, 0.130526, 0.991445] },
    },
    settings: { margin: 0.2, featureAngle: 0.01, maxPoints: 0, relativeTolerance: 0, solver: 'portal' },
    view: [2.2, -3.4, 1.9],
  };
}

/** Numbers are written as the shortest text that reads back to the same bits. */
export function toHash(scene: Scene): string {
  const { settings } = scene;
  const fields: [string, string][] = SIDES.flatMap((side) => {
    const { shape, position, rotation } = scene.bodies[side];
    const named: [string, string][] = [
      [side, shape.name],
      [`${side}.at`, position.join()],
      [`${side}.turn`, rotation.join()],
    ];
    return shape.name === OWN ? [...named, [`${side}.points`, shape.points.join()]] : named;
  });
  fields.push(
    ['margin', `${settings.margin}`],
    ['angle', `${settings.featureAngle}`],
    ['most', `${settings.maxPoints}`],
    ['tolerance', `${settings.relativeTolerance}`],
    ['solver', settings.solver],
    ['view', scene.view.join()],
  );
  return `#${fields.map(([key, value]) => `${key}=${encodeURIComponent(value).replaceAll('%2C', ',')}`).join('&')}`;
}

/** Missing fields are those of the first scene. Throws an error with a message if a field is invalid. */
export function fromHash(hash: string): Scene {
  const fields = new URLSearchParams(hash.replace(/^#/, ''));
  const scene = firstScene();
  for (const side of SIDES) readBody(scene.bodies[side], side, fields);
  readSettings(scene.settings, fields);
  scene.view = numbers(fields, 'view', 3, scene.view) as Triple;
  return scene;
}

function readBody(body: Body, side: string, fields: URLSearchParams): void {
  const name = fields.get(side);
  if (name === OWN) {
    const points = numbers(fields, `${side}.points`, 0, []);
    if (points.length < 12 || points.length % 3 !== 0) throw wrong(`${side}.points`);
    body.shape = { name, points };
  } else if (name !== null) {
    const shape = preset(name);
    if (!shape) throw wrong(side);
    body.shape = shape;
  }
  body.position = numbers(fields, `${side}.at`, 3, body.position) as Triple;
  body.rotation = numbers(fields, `${side}.turn`, 4, body.rotation) as Quad;
}

function readSettings(settings: Settings, fields: URLSearchParams): void {
  const within = (key: string, value: number, most: number) => {
    const [given] = numbers(fields, key, 1, [value]);
    if (!(given! >= 0 && given! <= most)) throw wrong(key);
    return given!;
  };
  settings.margin = within('margin', settings.margin, Number.MAX_VALUE);
  settings.featureAngle = within('angle', settings.featureAngle, 0.5);
  settings.maxPoints = Math.round(within('most', settings.maxPoints, 1000));
  settings.relativeTolerance = within('tolerance', settings.relativeTolerance, 1);
  const solver = fields.get('solver') ?? settings.solver;
  if (solver !== 'portal' && solver !== 'gjk') throw wrong('solver');
  settings.solver = solver;
}

/** The finite numbers of a field; `count` of them, or any number if `count` is 0. */
function numbers(fields: URLSearchParams, key: string, count: number, otherwise: number[]): number[] {
  const text = fields.get(key);
  if (text === null) return otherwise;
  const values = text.split(',').map((value) => (value.trim() === '' ? NaN : Number(value)));
  if ((count > 0 && values.length !== count) || !values.every(Number.isFinite)) throw wrong(key);
  return values;
}

function wrong(key: string): Error {
  return new Error(`The link’s “${key}” cannot be read; the page shows its first scene instead.`);
}
