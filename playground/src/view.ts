// A three-dimensional picture: a canvas that is drawn again after changes.

import {
  AmbientLight,
  DirectionalLight,
  PerspectiveCamera,
  Scene,
  Vector3,
  WebGLRenderer,
  type Object3D,
} from 'three';
import { darkness } from './look.js';

/** A text in the picture, which stays upright and readable. */
interface Label {
  element: HTMLElement;
  at: Vector3;
}

export class View {
  readonly scene = new Scene();
  readonly camera = new PerspectiveCamera(32, 1, 0.01, 1000);
  readonly canvas: HTMLCanvasElement;
  /** Called before each drawing. */
  beforeDraw: () => void = () => {};
  private readonly renderer: WebGLRenderer;
  private readonly labels = new Map<string, Label>();
  private isDue = false;

  constructor(private readonly frame: HTMLElement) {
    this.renderer = new WebGLRenderer({ antialias: true, alpha: true });
    this.canvas = this.renderer.domElement;
    frame.prepend(this.canvas);
    this.camera.up.set(0, 0, 1);
    const sun = new DirectionalLight(0xffffff, 2);
    sun.position.set(1, 1.5, 3);
    // The light comes from the reader's side.
    this.camera.add(sun);
    this.scene.add(this.camera, new AmbientLight(0xffffff, 0.9));
    new ResizeObserver(() => this.resize()).observe(frame);
    darkness.addEventListener('change', () => this.draw());
  }

  add(...objects: Object3D[]): void {
    this.scene.add(...objects);
  }

  /** Draws before the next repaint of the window. */
  draw(): void {
    if (this.isDue) return;
    this.isDue = true;
    requestAnimationFrame(() => {
      this.isDue = false;
      this.beforeDraw();
      this.renderer.render(this.scene, this.camera);
      for (const label of this.labels.values()) this.place(label);
    });
  }

  /** Shows `text` at `at`, or removes the label if `at` is undefined. */
  label(key: string, text: string, at: Vector3 | undefined, kind = key): void {
    const label = this.labels.get(key);
    if (!at) {
      label?.element.remove();
      this.labels.delete(key);
      return;
    }
    const element = label?.element ?? document.createElement('span');
    if (!label) {
      element.className = `label ${kind}`;
      element.ariaHidden = 'true';
      this.frame.append(element);
    }
    element.textContent = text;
    this.labels.set(key, { element, at: at.clone() });
  }

  /** Removes the labels whose keys begin with `prefix`. */
  unlabel(prefix: string): void {
    for (const key of [...this.labels.keys()]) if (key.startsWith(prefix)) this.label(key, '', undefined);
  }

  private place({ element, at }: Label): void {
    const { x, y, z } = at.clone().project(this.camera);
    element.hidden = Math.abs(z) > 1;
    const { clientWidth, clientHeight } = this.frame;
    element.style.transform = `translate(${((x + 1) / 2) * clientWidth}px, ${((1 - y) / 2) * clientHeight}px)`;
  }

  private resize(): void {
    const { clientWidth, clientHeight } = this.frame;
    if (clientWidth === 0 || clientHeight === 0) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(clientWidth, clientHeight);
    this.camera.aspect = clientWidth / clientHeight;
    this.camera.updateProjectionMatrix();
    this.draw();
  }
}
