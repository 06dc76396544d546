// The forms: hulls, pasted points and query settings.

import { OWN, SIDES, type Scene, type Settings, type Shape, type Side } from './model.js';
import { element } from './numbers.js';
import { parsePoints } from './parse.js';
import { preset, PRESETS } from './shapes.js';

type Numeric = Exclude<keyof Settings, 'solver'>;

interface Control {
  setting: Numeric;
  most: number;
  /** Converts the slider's position to the number. */
  /** Converts the number to the slider's position. */
  value: (place: number) => number;
  place: (value: number) => number;
}

const same = (value: number) => value;

const CONTROLS: Record<string, Control> = {
  // 0, then 1e-4 to 10 on a logarithmic scale.
  margin: {
    setting: 'margin',
    most: Number.MAX_VALUE,
    value: (place) => (place === 0 ? 0 : Number((10 ** (place / 20 - 4)).toPrecision(3))),
    place: (value) => (value === 0 ? 0 : 20 * (Math.log10(value) + 4)),
  },
  angle: { setting: 'featureAngle', most: 0.5, value: same, place: same },
  most: { setting: 'maxPoints', most: 1000, value: same, place: same },
  // 0, then 1e-14 to 1.
  tolerance: {
    setting: 'relativeTolerance',
    most: 1,
    value: (place) => (place === 0 ? 0 : Number(`1e${place - 15}`)),
    place: (value) => (value === 0 ? 0 : Math.log10(value) + 15),
  },
};

/**
 * Connects the forms to the scene. `changed` is called after every change of the scene; `reshaped` is called before
 * it if a hull was replaced. Returns a function that shows a scene in the forms.
 */
export function controls(scene: () => Scene, changed: () => void, reshaped: () => void): () => void {
  const settings = numericControls(scene, changed);
  const solver = element<HTMLSelectElement>('solver');
  solver.addEventListener('change', () => {
    scene().settings.solver = solver.value as Settings['solver'];
    changed();
  });
  const choosers = SIDES.map((side) => chooser(side, scene, changed, reshaped));
  return () => {
    settings();
    solver.value = scene().settings.solver;
    choosers.forEach((show) => show());
  };
}

function numericControls(scene: () => Scene, changed: () => void): () => void {
  const shows = Object.entries(CONTROLS).map(([id, { setting, most, value, place }]) => {
    const [range, field] = [element<HTMLInputElement>(`${id}-range`), element<HTMLInputElement>(id)];
    range.addEventListener('input', () => {
      const given = value(range.valueAsNumber);
      scene().settings[setting] = given;
      field.value = `${given}`;
      field.ariaInvalid = null;
      changed();
    });
    field.addEventListener('input', () => {
      const given = field.valueAsNumber;
      const isGood = given >= 0 && given <= most && (setting !== 'maxPoints' || Number.isInteger(given));
      field.ariaInvalid = isGood ? null : 'true';
      if (!isGood) return;
      scene().settings[setting] = given;
      range.value = `${place(given)}`;
      changed();
    });
    return () => {
      const now = scene().settings[setting];
      [field.value, range.value] = [`${now}`, `${place(now)}`];
    };
  });
  return () => shows.forEach((show) => show());
}

function chooser(side: Side, scene: () => Scene, changed: () => void, reshaped: () => void): () => void {
  const select = element<HTMLSelectElement>(`shape-${side}`);
  for (const [name, { label }] of Object.entries(PRESETS)) select.add(new Option(label, name));
  const own = new Option('Own points', OWN);
  const use = (shape: Shape) => {
    scene().bodies[side].shape = shape;
    show();
    reshaped();
    changed();
  };
  const show = () => {
    const { shape } = scene().bodies[side];
    if (shape.name === OWN) select.add(own);
    else own.remove();
    select.value = shape.name;
    element(`handle-${side}`).ariaLabel = `Hull ${side.toUpperCase()}: ${select.selectedOptions[0]?.label ?? ''}`;
  };
  select.addEventListener('change', () => {
    const shape = preset(select.value);
    if (shape) use(shape);
  });
  element(`paste-${side}`).addEventListener('click', () => paste(side, use));
  return show;
}

/** Shows the dialog for pasted points; `use` receives the shape. */
function paste(side: Side, use: (shape: Shape) => void): void {
  const dialog = element<HTMLDialogElement>('paste');
  const text = element<HTMLTextAreaElement>('paste-text');
  const file = element<HTMLInputElement>('paste-file');
  const complaint = element('paste-error');
  element('paste-side').textContent = side.toUpperCase();
  complaint.textContent = '';
  const closed = new AbortController();
  const listen = { signal: closed.signal };
  element('paste-use').addEventListener(
    'click',
    (event) => {
      event.preventDefault();
      try {
        use({ name: OWN, points: parsePoints(text.value) });
        dialog.close();
      } catch (error) {
        complaint.textContent = (error as Error).message;
      }
    },
    listen,
  );
  file.addEventListener('change', async () => (text.value = (await file.files?.[0]?.text()) ?? text.value), listen);
  element('paste-cancel').addEventListener('click', () => dialog.close(), listen);
  dialog.addEventListener('close', () => closed.abort(), listen);
  dialog.showModal();
}
