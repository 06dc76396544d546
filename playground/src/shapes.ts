// The hulls that the page offers, as points.

import robotLinks from 'hullcast:robot';
import type { Shape, Triple } from './model.js';

interface Preset {
  label: string;
  points: () => number[];
}

export const PRESETS: Record<string, Preset> = {
  box: { label: 'Box', points: () => box(0.5, 0.4, 0.3) },
  plate: { label: 'Plate', points: () => box(1, 0.8, 0.08) },
  tetrahedron: {
    label: 'Tetrahedron',
    points: () => [0.6, 0.6, 0.6, -0.6, -0.6, 0.6, -0.6, 0.6, -0.6, 0.6, -0.6, -0.6],
  },
  prism: { label: 'Hexagonal prism', points: () => prism(6, 0.55, 0.35) },
  cylinder: { label: 'Cylinder', points: () => prism(32, 0.45, 0.4) },
  poly16: { label: '16 points (poly16)', points: () => ellipsoid(16, [0.7, 0.55, 0.45]) },
  ball: { label: 'Ball', points: () => ellipsoid(120, [0.5, 0.5, 0.5]) },
  // Two links of the Panda arm: link 5 and the hand.
  link: { label: 'Robot link', points: () => grown(robotLinks[0], 4) },
  hand: { label: 'Robot hand', points: () => grown(robotLinks[1], 6) },
};

const made = new Map<string, Shape>();

/** The preset of this name; always the same object. */
export function preset(name: string): Shape | undefined {
  const found = Object.hasOwn(PRESETS, name) ? PRESETS[name] : undefined;
  if (found && !made.has(name)) made.set(name, { name, points: found.points() });
  return made.get(name);
}

function box(x: number, y: number, z: number): number[] {
  const signs = [-1, 1];
  return signs.flatMap((i) => signs.flatMap((j) => signs.flatMap((k) => [i * x, j * y, k * z])));
}

/** A prism whose axis is z. */
function prism(sides: number, radius: number, half: number): number[] {
  return Array.from({ length: sides }, (_, i) => {
    const angle = (2 * Math.PI * i) / sides;
    const [x, y] = [radius * Math.cos(angle), radius * Math.sin(angle)];
    return [x, y, -half, x, y, half];
  }).flat();
}

/** Points spread evenly by the golden angle, from pole to pole. */
function ellipsoid(count: number, [x, y, z]: Triple): number[] {
  return Array.from({ length: count }, (_, i) => {
    const height = 1 - (2 * i + 1) / count;
    const radius = Math.sqrt(1 - height * height);
    const angle = i * Math.PI * (3 - Math.sqrt(5));
    return [x * radius * Math.cos(angle), y * radius * Math.sin(angle), z * height];
  }).flat();
}

/** The points, scaled about their middle. The links measure decimetres, the other shapes about a metre. */
function grown(points: readonly number[], factor: number): number[] {
  const middle = [0, 1, 2].map((axis) => {
    const along = points.filter((_, i) => i % 3 === axis);
    return (Math.min(...along) + Math.max(...along)) / 2;
  });
  return points.map((value, i) => factor * (value - middle[i % 3]!));
}
