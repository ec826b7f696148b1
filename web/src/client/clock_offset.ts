// SPDX-License-Identifier: MIT

export interface ClockEstimate {
  /** The broker's clock is ahead of ours by so much, */
  offsetUs: number;
  /** give or take this. */
  errorUs: number;
  roundTripUs: number;
}

const WINDOW = 32;

/** The sample of the least round trip of the last 32, as common/net/clock_offset.h. */
export class ClockOffset {
  #samples: ClockEstimate[] = [];

  add(sentUs: number, peerUs: bigint, receivedUs: number): void {
    if (receivedUs < sentUs) return;
    const roundTripUs = receivedUs - sentUs;
    const offsetUs = Number(peerUs - BigInt(sentUs + Math.floor(roundTripUs / 2)));
    this.#samples = [...this.#samples, { offsetUs, errorUs: Math.ceil(roundTripUs / 2), roundTripUs }].slice(-WINDOW);
  }
  get estimate(): ClockEstimate | undefined {
    return this.#samples.reduce<ClockEstimate | undefined>((best, one) => (best && best.roundTripUs <= one.roundTripUs ? best : one), undefined);
  }
  reset(): void {
    this.#samples = [];
  }
}
