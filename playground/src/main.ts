// The playground: a scene, the query about it, and its pictures.

import { Asking } from './asking.js';
import { controls } from './controls.js';
import { GaussMaps } from './gauss.js';
import { SIDES, type Answer, type Hull, type Scene, type Side, type Triple } from './model.js';
import { movable } from './moving.js';
import { element, showNumbers } from './numbers.js';
import { Projection } from './projection.js';
import { setToken } from './service.js';
import { firstScene, fromHash, toHash } from './share.js';
import { Stage, type Shown } from './stage.js';
import { asksForToken, errorInWords } from './words.js';

/** Browsers limit how often a page may change its address. */
const ADDRESS_MS = 300;

let scene = firstScene();
/** Set while the camera has to be aimed at hulls that are not known yet. */
let isFitDue = true;
let answered: { scene: Scene; answer: Answer } | undefined;

const stage = new Stage(element('stage'), lookedElsewhere);
const gauss = new GaussMaps(element('gauss'), stage.view.camera);
const projection = new Projection(element<SVGSVGElement>('plane'), stage.view.camera);
const handles: Record<Side, HTMLElement> = { a: element('handle-a'), b: element('handle-b') };
const moving = movable(stage, () => scene, handles, changed);
const showControls = controls(() => scene, changed, () => (isFitDue = true));

const asking = new Asking(() => scene, {
  hull(side: Side, hull: Hull) {
    stage.setHull(side, hull);
    gauss.setHull(side, hull);
    if (isFitDue) stage.fit(scene);
  },
  contacts(contacts, asked) {
    isFitDue = false;
    complain(undefined);
    answered = { scene: asked, answer: contacts.shown };
    showNumbers(contacts);
    showAnswer();
  },
  failed(error) {
    answered = undefined;
    complain(error);
    showAnswer();
  },
  busy(isBusy) {
    element('answer').ariaBusy = `${isBusy}`;
  },
});

/** A body or a setting has changed. */
function changed(): void {
  stage.setPoses(scene);
  asking.ask();
  addressLater();
}

function lookedElsewhere(): void {
  scene.view = stage.from.map((value) => Number(value.toPrecision(4))) as Triple;
  gauss.draw();
  projection.draw();
  addressLater();
}

function showAnswer(): void {
  const of = answered?.scene ?? scene;
  stage.setPoses(scene);
  stage.setAnswer(of, answered?.answer);
  gauss.setAnswer(of, answered?.answer);
  projection.setAnswer(of, stage.hulls, answered?.answer);
}

function complain(error: unknown): void {
  const place = element('error');
  place.hidden = error === undefined;
  place.textContent = error === undefined ? '' : errorInWords(error);
  element('token-form').hidden = !asksForToken(error);
  if (error !== undefined) element('status').textContent = 'No answer.';
}

let timer = 0;

function addressLater(): void {
  clearTimeout(timer);
  timer = setTimeout(() => history.replaceState(null, '', toHash(scene)), ADDRESS_MS);
}

/** Starts with the scene of a link. */
function begin(hash: string): void {
  const notice = element('notice');
  notice.hidden = true;
  try {
    scene = fromHash(hash);
  } catch (error) {
    scene = firstScene();
    notice.hidden = false;
    notice.textContent = errorInWords(error);
  }
  isFitDue = !hash.includes('view=');
  showControls();
  stage.look(scene);
  if (isFitDue) stage.fit(scene);
  changed();
}

element('fit').addEventListener('click', () => stage.fit(scene));
addEventListener('hashchange', () => begin(location.hash));
element('again').addEventListener('click', () => begin(''));
element('share').addEventListener('click', async (event) => {
  const button = event.currentTarget as HTMLButtonElement;
  history.replaceState(null, '', toHash(scene));
  // The clipboard exists only on secure pages. Without it the page's address is still the link.
  const isCopied = await navigator.clipboard?.writeText(location.href).then(() => true, () => false);
  button.textContent = isCopied ? 'Copied' : 'Copy it from the address bar';
  setTimeout(() => (button.textContent = 'Copy link'), 2000);
});
element('token-form').addEventListener('submit', (event) => {
  event.preventDefault();
  setToken(element<HTMLInputElement>('token').value.trim());
  asking.ask();
});
document.querySelectorAll<HTMLInputElement>('input[name="mode"]').forEach((input) =>
  input.addEventListener('change', () => (moving.turns = input.value === 'turn')),
);
for (const what of ['grown', 'features', 'points'] as const satisfies readonly (keyof Shown)[]) {
  const box = element<HTMLInputElement>(`show-${what}`);
  box.addEventListener('change', () => {
    stage.shown[what] = box.checked;
    showAnswer();
  });
}
for (const side of SIDES) stage.bodies[side].setPose(scene.bodies[side]);
begin(location.hash);
