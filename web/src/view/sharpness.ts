// SPDX-License-Identifier: MIT

const LEAST = 0.5, FINER = 1.15, PATIENCE = 6, LONG_PATIENCE = 90;

/**
 * How many pixels a picture has, as a part of the display's along each side: fewer where pictures are late in a row,
 * more after many that took less than half of their time. Time comes in as arguments.
 */
export class Sharpness {
  value = 1;
  #late = 0;
  #early = 0;

  /** workMs: of one picture; turnMs: the time that it may take. */
  add(workMs: number, turnMs: number): void {
    this.#late = workMs > 1.5 * turnMs ? this.#late + 1 : 0;
    this.#early = workMs < 0.5 * turnMs ? this.#early + 1 : 0;
    if (this.#late >= PATIENCE && this.value > LEAST) {
      this.value = Math.max(LEAST, this.value * Math.max(Math.sqrt(turnMs / workMs), 0.7));
      this.#late = 0;
    } else if (this.#early >= LONG_PATIENCE && this.value < 1) {
      this.value = Math.min(1, this.value * FINER);
      this.#early = 0;
    }
  }
}
