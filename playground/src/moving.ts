// Moves and turns the bodies by pointer, finger and keyboard.

import { Plane, Quaternion, Raycaster, Vector2, Vector3 } from 'three';
import type { Stage } from './stage.js';
import { SIDES, type Body, type Quad, type Scene, type Side, type Triple } from './model.js';

/** The rotation per pixel of a drag. */
const RADIANS_PER_PIXEL = 0.008;
/** The step of a key press: a fraction of the circumradius, and radians; a tenth of it with Control. */
const KEY_STEP = 0.02;
const KEY_TURN = Math.PI / 90;

export interface Moving {
  /** Whether a drag turns the body. Otherwise it moves it; Shift or the right button does the other. */
  turns: boolean;
}

/** Lets the reader move the bodies; calls `moved` after every change. */
export function movable(
  stage: Stage,
  scene: () => Scene,
  handles: Record<Side, HTMLElement>,
  moved: () => void,
): Moving {
  const moving: Moving = { turns: false };
  const { canvas, camera } = stage.view;
  const across = (x: number, y: number) => new Vector3(x, y, 0).applyQuaternion(camera.quaternion);

  const turn = (body: Body, axis: Vector3, angle: number) => {
    const rotation = new Quaternion().setFromAxisAngle(axis, angle).multiply(new Quaternion(...body.rotation));
    body.rotation = rotation.normalize().toArray().map((value) => rounded(value, 1e-6)) as Quad;
  };
  const move = (body: Body, to: Vector3) => {
    const step = 10 ** (Math.floor(Math.log10(stage.size)) - 4);
    body.position = to.toArray().map((value) => rounded(value, step)) as Triple;
  };

  /** The ray through the pointer's position. */
  const ray = (event: PointerEvent) => {
    const { left, top, width, height } = canvas.getBoundingClientRect();
    const at = new Vector2((2 * (event.clientX - left)) / width - 1, 1 - (2 * (event.clientY - top)) / height);
    const caster = new Raycaster();
    caster.setFromCamera(at, camera);
    return caster;
  };

  // Capture phase: runs before the camera's own listener, which must not see a drag of a body.
  canvas.addEventListener(
    'pointerdown',
    (event) => {
      const meshes = SIDES.flatMap((side) => stage.bodies[side].mesh ?? []);
      const hit = ray(event).intersectObjects(meshes, false)[0];
      if (!hit || !event.isPrimary) return;
      event.stopImmediatePropagation();
      event.preventDefault();
      const side = hit.object.userData.side as Side;
      handles[side].focus({ preventScroll: true });
      canvas.setPointerCapture(event.pointerId);
      const body = scene().bodies[side];
      const turns = moving.turns !== (event.shiftKey || event.button === 2);
      const facing = new Plane().setFromNormalAndCoplanarPoint(camera.getWorldDirection(new Vector3()), hit.point);
      const offset = new Vector3(...body.position).sub(hit.point);
      let [x, y] = [event.clientX, event.clientY];
      const drag = (next: PointerEvent) => {
        if (next.pointerId !== event.pointerId) return;
        if (turns) {
          turn(body, across(0, 1), (next.clientX - x) * RADIANS_PER_PIXEL);
          turn(body, across(1, 0), (next.clientY - y) * RADIANS_PER_PIXEL);
          [x, y] = [next.clientX, next.clientY];
        } else {
          const at = ray(next).ray.intersectPlane(facing, new Vector3());
          if (at) move(body, at.add(offset));
        }
        moved();
      };
      const released = new AbortController();
      canvas.addEventListener('pointermove', drag, { signal: released.signal });
      for (const end of ['pointerup', 'pointercancel'] as const) {
        canvas.addEventListener(end, () => released.abort(), { signal: released.signal });
      }
    },
    { capture: true },
  );
  canvas.addEventListener('contextmenu', (event) => event.preventDefault());

  for (const side of SIDES) {
    const handle = handles[side];
    handle.addEventListener('focus', () => focused(side, true));
    handle.addEventListener('blur', () => focused(side, false));
    handle.addEventListener('keydown', (event) => {
      const steps = KEYS[event.key];
      if (!steps || event.altKey) return;
      event.preventDefault();
      const [kind, sign] = steps;
      const share = sign * (event.ctrlKey || event.metaKey ? 0.1 : 1);
      const body = scene().bodies[side];
      const axes = screenAxes(across);
      if (event.shiftKey) turn(body, axes[TURNS[kind]].clone(), share * KEY_TURN * (kind === 'up' ? -1 : 1));
      else move(body, new Vector3(...body.position).addScaledVector(axes[kind], share * KEY_STEP * stage.size));
      moved();
    });
  }
  const focused = (side: Side, has: boolean) => {
    stage.bodies[side].setFocus(has);
    stage.view.draw();
  };
  return moving;
}

type Axis = 'right' | 'up' | 'back';

const KEYS: Record<string, [Axis, number]> = {
  ArrowLeft: ['right', -1],
  ArrowRight: ['right', 1],
  ArrowDown: ['up', -1],
  ArrowUp: ['up', 1],
  PageUp: ['back', -1],
  PageDown: ['back', 1],
};

/** The axis about which each key turns. */
const TURNS: Record<Axis, Axis> = { right: 'up', up: 'right', back: 'back' };

/** The world axes that are nearest to the picture's axes; keys move along them. */
function screenAxes(across: (x: number, y: number) => Vector3): Record<Axis, Vector3> {
  const world = [new Vector3(1, 0, 0), new Vector3(0, 1, 0), new Vector3(0, 0, 1)];
  const nearest = (direction: Vector3) => {
    const along = world.map((axis) => Math.abs(axis.dot(direction)));
    const axis = world.splice(along.indexOf(Math.max(...along)), 1)[0]!;
    return axis.dot(direction) < 0 ? axis.negate() : axis;
  };
  const [right, up] = [nearest(across(1, 0)), nearest(across(0, 1))];
  return { right, up, back: right.clone().cross(up) };
}

function rounded(value: number, step: number): number {
  const steps = Math.round(value / step);
  // Divide if possible: the quotient's shortest decimal text has no tail of digits.
  return (step < 1 ? steps / Math.round(1 / step) : steps * step) || 0;
}
