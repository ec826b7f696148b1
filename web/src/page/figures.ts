// SPDX-License-Identifier: MIT
import type { StreamInfo } from '../client/control.js';
import type { Profile } from '../client/profile.js';
import type { Shown } from '../core/playout.js';

// Figures in the words of the native client (client/hud_text.cpp). Loaded with them.

const commas = (value: number): string => value.toLocaleString('en-US');

export function textFromMode(profile: Required<Profile>): string {
  if (profile.rate === 'raw') return 'raw';
  return `${profile.rate} x${profile.k}${profile.scheme === 'linear' ? '' : ` ${profile.scheme}`}`;
}

export interface Figures {
  keysHz: number;
  posesHz: number;
  drawnHz: number;
  kbitPerS: number;
  roundTripMs: number | undefined;
  vertices: number;
  verticesTotal: number;
  faces: number;
  profile: Required<Profile> | undefined;
  shown: Shown;
  /** When what is shown was captured. */
  utcUs: bigint | undefined;
  delayMs: number;
  workMs: number;
  load: number;
  bands: number;
  bandsTotal: number;
  rank: number;
}
const DAY_US = 86_400_000_000n;

/** When the pose of a capture time was captured, since 1970; with a sender that does not say it, on its own clock. */
export function utcOf({ utc_us = 0n, rewind }: Pick<StreamInfo, 'utc_us' | 'rewind'>, captureUs: bigint): bigint {
  return utc_us + (rewind ? rewind.capture_us + BigInt(Math.round(Number(captureUs - rewind.capture_us) * rewind.speed)) : captureUs);
}

/** Of a day, as the native client's. */
export function timecodeOf(utcUs: bigint): string {
  return new Date(Number((((utcUs % DAY_US) + DAY_US) % DAY_US) / 1000n)).toISOString().slice(11, 23);
}
export function figureLines(f: Figures): string[] {
  const ms = (value: number): string => `${value < 10 ? value.toFixed(1) : Math.round(value)} ms`;
  return [
    `${Math.round(f.keysHz)} keys/s · ${Math.round(f.posesHz)} poses/s · ${Math.round(f.drawnHz)} drawn/s`,
    `${Math.round(f.kbitPerS)} kbit/s · round trip ${f.roundTripMs === undefined ? 'not known yet' : ms(f.roundTripMs)}`,
    `LOD ${(f.verticesTotal === 0 ? 0 : f.vertices / f.verticesTotal).toFixed(2)} · ${commas(f.vertices)} of ${commas(f.verticesTotal)} vertices, ${f.faces === 0 ? 'points' : `${commas(f.faces)} faces`}`,
    f.profile ? textFromMode(f.profile) : '',
    `${f.shown} · ${ms(f.delayMs)} held back${f.utcUs === undefined ? '' : ` · ${timecodeOf(f.utcUs)}`}`,
    // Over twice a picture's time: not even the fewest vertices would hold the rate.
    `${ms(f.workMs)} a picture · ${f.load > 2 ? 'out of reach here' : `${Math.round(100 * f.load)} % planned`}`,
    `bands ${f.bands} of ${f.bandsTotal} · rank ${f.rank}`,
  ].filter((line) => line !== '');
}
