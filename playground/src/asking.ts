// One question at a time, the newest.

import { HullMissing, query, register } from './service.js';
import { SIDES, type Contacts, type Hull, type Scene, type Shape, type Side } from './model.js';

export interface Listener {
  /** The hull of a side is known. */
  hull(side: Side, hull: Hull): void;
  /** What was asked last, of this scene, is answered. */
  contacts(contacts: Contacts, scene: Scene): void;
  /** It could not be. */
  failed(error: unknown): void;
  /** Whether a question is under way. */
  busy(isBusy: boolean): void;
}

/** Asks about a scene as often as it changed, one call at a time. */
export class Asking {
  private readonly known = new Map<Shape, Hull>();
  private readonly shown: Partial<Record<Side, Hull>> = {};
  private changed = false;
  private busy = false;

  constructor(
    private readonly scene: () => Scene,
    private readonly listener: Listener,
  ) {}

  /** Something changed: asks once the call under way is answered. */
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
    // The answer is about the scene of this moment.
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
