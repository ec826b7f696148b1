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

/** How a picture is drawn. */
export interface Quality {
  /** The part of its pixels along each side. */
  resolution: number;
  /** A pixel; 0: one. */
  samples: number;
  /** 0: the whole of it, 1: of half the texels. */
  shadow: number;
}
export const FULL: Readonly<Quality> = { resolution: 1, samples: 4, shadow: 0 };

/** What eigencast-levels.wasm exports, beside what it has of a Core's: web/core/core.h. */
interface Exports {
  levels_make(picturesPerSecond: number, deadline: number): number;
  levels_free(levels: number): void;
  levels_resolve(levels: number, objects: number, count: number, nowUs: bigint, seconds: number): number;
  levels_state(levels: number): number;
  levels_resolution(levels: number): number;
  levels_samples(levels: number): number;
  levels_shadow(levels: number): number;
}

const OBJECT_BYTES = 40;

/** How many vertices each surface has, and how pictures are drawn, so that they are in time: common/levels. Call free() when done. */
export class Levels {
  readonly #core: Core;
  readonly #exports: Exports;
  readonly #at: number;
  #quality = FULL;

  /** core: an instance of eigencast-levels.wasm. */
  constructor(core: Core, picturesPerSecond = 60, deadline = 1) {
    this.#core = core;
    this.#exports = core.exports as unknown as Exports;
    this.#at = core.found(this.#exports.levels_make(picturesPerSecond, deadline));
  }
  free(): void {
    this.#exports.levels_free(this.#at);
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
    const levels = core.found(this.#exports.levels_resolve(this.#at, at, objects.length, nowUs, seconds)), { levels_resolution, levels_samples, levels_shadow } = this.#exports;
    const [resolution, samples, shadow] = [levels_resolution(this.#at), levels_samples(this.#at) === 0 ? FULL.samples : 0, levels_shadow(this.#at)], was = this.#quality;
    if (resolution !== was.resolution || samples !== was.samples || shadow !== was.shadow) this.#quality = { resolution, samples, shadow };
    return Array.from(core.words(levels, objects.length));
  }
  /** Of the next picture; another object where it is another. */
  get quality(): Readonly<Quality> {
    return this.#quality;
  }
  get state(): number {
    return this.#exports.levels_state(this.#at);
  }
}
