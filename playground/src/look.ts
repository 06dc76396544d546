// Colours, as the style sheet has them, and what is drawn with them.

import {
  Color,
  DoubleSide,
  MeshBasicMaterial,
  MeshStandardMaterial,
  type BufferGeometry,
  type InstancedMesh,
  type Object3D,
} from 'three';
import { LineMaterial } from 'three/addons/lines/LineMaterial.js';
import { LineSegments2 } from 'three/addons/lines/LineSegments2.js';
import { LineSegmentsGeometry } from 'three/addons/lines/LineSegmentsGeometry.js';

export type Name = 'a' | 'b' | 'contact' | 'normal' | 'ink' | 'sphere';

export interface LineLook {
  name: Name;
  /** CSS pixels. */
  width: number;
  opacity?: number;
  /** Seen through what is before it. */
  onTop?: boolean;
}

type Material = LineMaterial | MeshBasicMaterial | MeshStandardMaterial;

/**
 * One material for each look, for ever: a material that goes takes its program off the graphics
 * card, and what is drawn anew at every answer would be compiled anew.
 */
const materials = new Map<string, { material: Material; name: Name }>();

function shared<M extends Material>(name: Name, key: string, make: () => M): M {
  const known = materials.get(key);
  if (known) return known.material as M;
  const material = make();
  material.color.copy(colour(name));
  materials.set(key, { material, name });
  return material;
}

/** The colour of this name in the scheme, light or dark, that the reader has. */
function colour(name: Name): Color {
  return new Color(getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim());
}

export const darkness = matchMedia('(prefers-color-scheme: dark)');
darkness.addEventListener('change', () => {
  for (const { material, name } of materials.values()) material.color.copy(colour(name));
});

/** Segments, six numbers each. */
export function lines(segments: number[], { name, width, opacity = 1, onTop = false }: LineLook): LineSegments2 {
  const geometry = new LineSegmentsGeometry();
  geometry.setPositions(segments);
  const transparent = opacity < 1 || onTop;
  const material = shared(name, `line ${name} ${width} ${opacity} ${onTop}`, () => {
    const settings = { linewidth: width, transparent, opacity, depthTest: !onTop, depthWrite: !transparent };
    return new LineMaterial(settings);
  });
  const object = new LineSegments2(geometry, material);
  object.renderOrder = onTop ? 3 : 1;
  object.frustumCulled = false;
  return object;
}

/** A hull's faces: light falls on them, and they are seen through. */
export function glass(name: Name, opacity: number): MeshStandardMaterial {
  const settings = { transparent: true, opacity, roughness: 0.75, flatShading: true, side: DoubleSide, depthWrite: false };
  return shared(name, `glass ${name} ${opacity}`, () => new MeshStandardMaterial(settings));
}

/** One colour everywhere, whatever is before it. */
export function marker(name: Name, opacity = 1): MeshBasicMaterial {
  const settings = { transparent: true, opacity, side: DoubleSide, depthTest: false, depthWrite: false };
  return shared(name, `marker ${name} ${opacity}`, () => new MeshBasicMaterial(settings));
}

/** One colour everywhere. */
export function plain(name: Name, opacity = 1): MeshBasicMaterial {
  const settings = { transparent: opacity < 1, opacity };
  return shared(name, `plain ${name} ${opacity}`, () => new MeshBasicMaterial(settings));
}

/** Takes everything out of a group, and its shapes off the graphics card. */
export function clear(group: Object3D): void {
  for (const child of [...group.children]) {
    const { geometry, dispose } = child as Partial<InstancedMesh>;
    if (geometry && !isKept(geometry)) geometry.dispose();
    dispose?.call(child);
    group.remove(child);
  }
}

/** Marks a geometry that many objects share. */
export function kept<G extends BufferGeometry>(geometry: G): G {
  geometry.userData.isKept = true;
  return geometry;
}

function isKept(geometry: BufferGeometry): boolean {
  return geometry.userData.isKept === true;
}
