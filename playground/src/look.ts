// The colours of the style sheet, and the objects that are drawn with them.

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
  /** Width in CSS pixels. */
  width: number;
  opacity?: number;
  /** Drawn also where other objects are in front. */
  onTop?: boolean;
}

type Material = LineMaterial | MeshBasicMaterial | MeshStandardMaterial;

/**
 * One material for each appearance, kept for the life of the page. Disposing of a material removes its program from
 * the graphics card, and the program would have to be compiled again for every answer.
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

/** The colour of this name in the reader's colour scheme, light or dark. */
function colour(name: Name): Color {
  return new Color(getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim());
}

export const darkness = matchMedia('(prefers-color-scheme: dark)');
darkness.addEventListener('change', () => {
  for (const { material, name } of materials.values()) material.color.copy(colour(name));
});

/** Line segments, six coordinates each. */
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

/** A material for a hull's faces: lit and transparent. */
export function glass(name: Name, opacity: number): MeshStandardMaterial {
  const settings = { transparent: true, opacity, roughness: 0.75, flatShading: true, side: DoubleSide, depthWrite: false };
  return shared(name, `glass ${name} ${opacity}`, () => new MeshStandardMaterial(settings));
}

/** A material of uniform colour that is drawn also where other objects are in front. */
export function marker(name: Name, opacity = 1): MeshBasicMaterial {
  const settings = { transparent: true, opacity, side: DoubleSide, depthTest: false, depthWrite: false };
  return shared(name, `marker ${name} ${opacity}`, () => new MeshBasicMaterial(settings));
}

/** A material of uniform colour. */
export function plain(name: Name, opacity = 1): MeshBasicMaterial {
  const settings = { transparent: opacity < 1, opacity };
  return shared(name, `plain ${name} ${opacity}`, () => new MeshBasicMaterial(settings));
}

/** Removes all objects from a group, and their geometries from the graphics card. */
export function clear(group: Object3D): void {
  for (const child of [...group.children]) {
    const { geometry, dispose } = child as Partial<InstancedMesh>;
    if (geometry && !isKept(geometry)) geometry.dispose();
    dispose?.call(child);
    group.remove(child);
  }
}

/** Marks a geometry that many objects share, so that `clear` keeps it. */
export function kept<G extends BufferGeometry>(geometry: G): G {
  geometry.userData.isKept = true;
  return geometry;
}

function isKept(geometry: BufferGeometry): boolean {
  return geometry.userData.isKept === true;
}
