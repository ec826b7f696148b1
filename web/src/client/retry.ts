// SPDX-License-Identifier: MIT

export interface Failure {
  code: string;
  message: string;
  /** It will not change soon: the longest pause at once. */
  refused?: boolean;
  /** Do not come back. */
  forGood?: boolean;
  /** At least so long, as Retry-After says. */
  minWaitMs?: number;
}

const FIRST_MS = 200, LONGEST_MS = 5000, GOOD_AFTER_MS = 2000;
export const HOPELESS_MS = 30_000;
const MAX_HOLD_OFF_MS = 600_000;

/** first x 2^(failures - 1), at most longest, times 0.75 to 1.25 as unit goes from 0 to 1: common/net/backoff.h. */
export function retryDelay(failures: number, firstMs: number, longestMs: number, unit: number): number {
  return Math.round(Math.min(firstMs * 2 ** Math.min(failures - 1, 40), Math.max(longestMs, firstMs)) * (0.75 + 0.5 * unit));
}

/** How long to wait after which failure, as the native client does. Time comes in as arguments. */
export class Retry {
  #failures = 0;

  /**
   * openForMs   how long the connection had been open; nothing: it never was
   * holdOffMs   what the broker's `bye` asked for; 0: not to come back; nothing: it said none
   * unit        0 to 1, of chance
   * Returns the pause, 0: none, it is over.
   */
  after(failure: Failure, openForMs: number | undefined, holdOffMs: number | undefined, unit: number): number {
    if (failure.forGood) return 0;
    if (openForMs !== undefined && openForMs >= GOOD_AFTER_MS) this.#failures = 0;
    this.#failures += 1;
    const longest = failure.refused === true || holdOffMs === 0;
    let wait = retryDelay(longest ? 64 : this.#failures, FIRST_MS, LONGEST_MS, unit);
    const least = failure.minWaitMs ?? 0;
    if (least > wait) wait = retryDelay(1, least, least, unit);
    const hold = Math.min(holdOffMs ?? 0, MAX_HOLD_OFF_MS);
    return hold > wait ? hold + Math.round(0.25 * unit * hold) : wait;
  }
  forgive(): void {
    this.#failures = 0;
  }
}

/** "; next try in 400 ms", "; next try in 3.9 s", or nothing when there is none. */
export function tryAgainIn(waitMs: number): string {
  if (waitMs <= 0) return '';
  if (waitMs < 1000) return `; next try in ${Math.round(waitMs)} ms`;
  const tenths = Math.floor((waitMs + 50) / 100);
  return `; next try in ${tenths < 100 ? (tenths / 10).toFixed(1) : Math.floor(tenths / 10)} s`;
}
