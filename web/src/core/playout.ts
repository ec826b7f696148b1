// SPDX-License-Identifier: MIT
import type { Core } from './module.js';

export const PLAYOUT_MODES = ['latest', 'interpolate', 'estimate'] as const;
export type PlayoutMode = (typeof PLAYOUT_MODES)[number];
/** How a pose came about; `held` for want of another. */
export const SHOWN = ['live', 'interpolated', 'estimated', 'held'] as const;
export type Shown = (typeof SHOWN)[number];

export interface PlayoutSettings {
  mode: PlayoutMode;
  /** 0, live: nothing is held; 1, smooth: poses are held for an interval and the jitter. Default: the mode's. */
  smoothness?: number;
  /** Poses are held for so long instead. */
  delayUs?: number;
  /** How long after the newest pose estimates end and are held (default: 200,000). */
  maxAheadUs?: number;
}
export interface ShownPose {
  timeUs: bigint;
  /** A view, of use until the next call of the core. */
  coefficients: Float64Array;
  bands: number;
  shown: Shown;
  /** An error shown before is fading. */
  settling: boolean;
}

/** What decides it. */
export type Playing = Pick<Playout, 'add' | 'addNext' | 'at' | 'delayUs' | 'free' | 'reset' | 'set' | 'setBandEnds'>;

/** Decides which pose is shown when: common/motion/playout.h. Times are microseconds. Call free() when done. */
export class Playout {
  readonly #core: Core;
  readonly #at: number;

  constructor(core: Core, settings: PlayoutSettings = { mode: 'interpolate' }) {
    this.#core = core;
    this.#at = core.exports.playout_make();
    this.set(settings);
  }
  free(): void {
    this.#core.exports.playout_free(this.#at);
  }

  set(settings: PlayoutSettings): void {
    const { exports } = this.#core;
    this.#core.checked(exports.playout_set(
      this.#at, PLAYOUT_MODES.indexOf(settings.mode), settings.smoothness ?? NaN, BigInt(settings.delayUs ?? 0),
      BigInt(settings.maxAheadUs ?? 200_000)));
  }
  setBandEnds(ends: readonly number[]): void {
    const at = this.#core.room(4 * ends.length);
    this.#core.words(at, ends.length).set(ends);
    this.#core.checked(this.#core.exports.playout_bands(this.#at, at, ends.length));
  }
  /** False: not after the newest, and dropped. */
  add(timeUs: bigint, arrivalUs: bigint, coefficients: ArrayLike<number>, bands: number, isEstimate: boolean): boolean {
    const at = this.#core.givenDoubles(coefficients);
    const { exports } = this.#core;
    return this.#core.checked(exports.playout_add(
      this.#at, timeUs, arrivalUs, at, coefficients.length, bands, isEstimate ? 1 : 0)) === 1;
  }
  /** A key that came before the poses that lead up to it. */
  addNext(timeUs: bigint, coefficients: ArrayLike<number>, bands: number): void {
    const at = this.#core.givenDoubles(coefficients);
    this.#core.checked(this.#core.exports.playout_add_next(this.#at, timeUs, at, coefficients.length, bands));
  }
  /** Nothing before the first pose came. */
  at(nowUs: bigint): ShownPose | undefined {
    const core = this.#core;
    const at = core.exports.playout_at(this.#at, nowUs);
    if (at === 0) return undefined;
    const data = core.data;
    return {
      timeUs: data.getBigInt64(at, true),
      coefficients: core.doubles(data.getUint32(at + 8, true), data.getUint32(at + 12, true)),
      bands: data.getUint8(at + 16),
      shown: SHOWN[data.getUint8(at + 17)] ?? 'held',
      settling: data.getUint8(at + 18) !== 0,
    };
  }
  /** The pose of so long ago is shown from now on; UNKNOWN: by the settings. Returns the lag that it needs; UNKNOWN: not yet. */
  keepLag(lagUs: bigint): bigint {
    return this.#core.exports.playout_keep_lag(this.#at, lagUs);
  }
  get delayUs(): number {
    return Number(this.#core.exports.playout_delay_us(this.#at));
  }
  reset(): void {
    this.#core.exports.playout_reset(this.#at);
  }
}
