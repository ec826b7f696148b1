// SPDX-License-Identifier: MIT
import type { Core } from './module.js';

export interface LevelObject {
  /** From the eye; scene units. */
  distance: number;
  /** Diameter on the screen; 0: out of sight. */
  pixels: number;
  /** Relative cost of a vertex; > 0. */
  vertexCost: number;
  max: number;
  min: number;
  /** In the last picture; 0: as resolved. */
  drawn: number;
}

const OBJECT_BYTES = 40;

/** How many vertices each surface is drawn with, so that pictures are in time: common/levels. Call free() when done. */
export class Levels {
  readonly #core: Core;
  readonly #at: number;

  constructor(core: Core, picturesPerSecond = 60, deadline = 1) {
    this.#core = core;
    this.#at = core.found(core.exports.levels_make(picturesPerSecond, deadline));
  }
  free(): void {
    this.#core.exports.levels_free(this.#at);
  }
  /** seconds: of work that the last picture took; 0: none yet. */
  resolve(objects: readonly LevelObject[], nowUs: bigint, seconds: number): number[] {
    const core = this.#core;
    const at = core.room(OBJECT_BYTES * objects.length);
    const data = core.data;
    objects.forEach((object, i) => {
      const to = at + OBJECT_BYTES * i;
      data.setFloat64(to, object.distance, true);
      data.setFloat64(to + 8, object.pixels, true);
      data.setFloat64(to + 16, object.vertexCost, true);
      [object.max, object.min, object.drawn, 0].forEach((value, k) => data.setUint32(to + 24 + 4 * k, value, true));
    });
    const levels = core.found(core.exports.levels_resolve(this.#at, at, objects.length, nowUs, seconds));
    return Array.from(core.words(levels, objects.length));
  }
  get state(): number {
    return this.#core.exports.levels_state(this.#at);
  }
}
