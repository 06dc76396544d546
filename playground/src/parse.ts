// Reads points from pasted text.

/** Longer text is refused. */
const MOST_CHARACTERS = 8 << 20;

/**
 * Reads three numbers per point from OBJ, JSON or lines of three numbers. Throws an error with a message for the
 * reader.
 */
export function parsePoints(text: string): number[] {
  if (text.length > MOST_CHARACTERS) throw new Error('The text is too long: at most 8 MB are accepted.');
  const trimmed = text.trim();
  const points = /^[[{]/.test(trimmed) ? fromJson(trimmed) : fromLines(trimmed);
  if (points.length < 12) {
    throw new Error(`A hull needs at least 4 points; the text has ${points.length / 3}.`);
  }
  return points;
}

/** Lines `v x y z` of an OBJ file, or lines `x y z`. The other lines of an OBJ file are skipped. */
function fromLines(text: string): number[] {
  const lines = text.split(/\r?\n/).map((line) => line.replace(/#.*/, '').trim());
  const isObj = lines.some((line) => /^v\s/.test(line));
  return lines.flatMap((line, i) => {
    if (line === '' || (isObj && !/^v\s/.test(line))) return [];
    const numbers = line.replace(/^v\s+/, '').split(/[\s,;]+/).map(Number);
    return point(numbers.slice(0, 3), `line ${i + 1}`);
  });
}

/** Points of `[[x, y, z], ...]`, of an object with `vertices`, or of the first hull of a scene. */
function fromJson(text: string): number[] {
  let value: unknown;
  try {
    value = JSON.parse(text);
  } catch (error) {
    throw new Error(`The text is not JSON: ${(error as Error).message}`);
  }
  const rows = vertices(value);
  if (!rows) throw new Error('JSON must be a list of [x, y, z], or an object with "vertices".');
  return rows.flatMap((row, i) => point(row, `point ${i + 1}`));
}

function vertices(value: unknown): unknown[] | undefined {
  if (Array.isArray(value)) return value;
  if (typeof value !== 'object' || value === null) return undefined;
  if ('vertices' in value) return vertices(value.vertices);
  if ('hulls' in value && Array.isArray(value.hulls)) return vertices(value.hulls[0]);
  return undefined;
}

function point(numbers: unknown, where: string): number[] {
  const good = Array.isArray(numbers) && numbers.length === 3 && numbers.every(Number.isFinite);
  if (!good) throw new Error(`Three finite numbers are needed: ${where} has something else.`);
  return numbers as number[];
}
