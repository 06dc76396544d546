// Keeps one call under way at a time, always about the newest scene.

import { HullMissing, query, register } from './service.js';
import { SIDES, type Contacts, type Hull, type Scene, type Shape, type Side } from './model.js';

export interface Listener {
  /** The hull of a side is registered and known. */
  hull(side: Side, hull: Hull): void;
  /** The latest question, about this scene, has its answer. */
  contacts(contacts: Contacts, scene: Scene): void;
  /** The latest question failed. */
  failed(error: unknown): void;
  /** Whether a question is under way. */
  busy(isBusy: boolean): void;
}

/** Asks about the scene after changes, one call at a time. */
export class Asking {
  private readonly known = new Map<Shape, Hull>();
  private readonly shown: Partial<Record<Side, Hull>> = {};
  private changed = false;
  private busy = false;

  constructor(
    private readonly scene: () => Scene,
    private readonly listener: Listener,
  ) {}

  /** Reports a change: the scene is queried as soon as the call under way has ended. */
  ask(): void {
    this.changed = true;
    if (!this.busy) void this.run();
  }

  private async run(): Promise<void> {
    this.busy = true;
    this.listener.busy(true);
    while (this.changed) {
      this.changed = false;
      try {
        await this.once();
      } catch (error) {
        this.listener.failed(error);
      }
    }
    this.busy = false;
    this.listener.busy(false);
  }

  private async once(): Promise<void> {
    // The answer belongs to the scene as it is now, so take a copy.
    const shapes = SIDES.map((side) => this.scene().bodies[side].shape);
    const scene = structuredClone(this.scene());
    for (const isLast of [false, true]) {
      const hulls = [await this.hull('a', shapes[0]!), await this.hull('b', shapes[1]!)];
      try {
        return this.listener.contacts(await query(scene, hulls), scene);
      } catch (error) {
        if (isLast || !(error instanceof HullMissing)) throw error;
        this.known.clear();
      }
    }
  }

  private async hull(side: Side, shape: Shape): Promise<Hull> {
    const hull = this.known.get(shape) ?? (await register(shape));
    this.known.set(shape, hull);
    if (this.shown[side] !== hull) this.listener.hull(side, hull);
    this.shown[side] = hull;
    return hull;
  }
}
