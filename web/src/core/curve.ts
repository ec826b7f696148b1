// SPDX-License-Identifier: MIT

/** Of a stream, by time in microseconds. */
export interface TimedPose {
  timeUs: number;
  coefficients: Float64Array;
}

/** A pause is not a neighbour: common/motion/playout_clock.h. */
const LONGEST_SPAN_US = 500_000;

/** The pose at a time from poses[i] to the next one, as the playout shows it: common/motion/curve.h. */
export function poseBetween(poses: readonly TimedPose[], i: number, timeUs: number): Float64Array {
  const [before, from, to, after] = [poses[i - 1], poses[i]!, poses[i + 1]!, poses[i + 2]], h = to.timeUs - from.timeUs;
  const span = (a: TimedPose | undefined, b: TimedPose | undefined): number => (a && b && Math.max(b.timeUs - a.timeUs, h) <= LONGEST_SPAN_US ? b.timeUs - a.timeUs : Infinity);
  const u = (timeUs - from.timeUs) / h, share = u * (u - 1), g0 = span(before, from), g1 = span(to, after);
  const s0 = ((g1 < Infinity ? share * (1 - u) : share) * h) / (g0 + h), s1 = ((g0 < Infinity ? share * u : share) * h) / (g1 + h);
  const w0 = (s0 * h) / g0, w1 = 1 - u - s0 * (1 + h / g0) + s1, w2 = u + s0 - s1 * (1 + h / g1), w3 = (s1 * h) / g1;
  const [A, C, D] = [before?.coefficients, to.coefficients, after?.coefficients];
  return from.coefficients.map((value, k) => w1 * value + w2 * C[k]! + w0 * (A?.[k] ?? 0) + w3 * (D?.[k] ?? 0));
}
