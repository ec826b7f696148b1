// SPDX-License-Identifier: MIT
import type { Profile } from '../client/profile.js';
import type { Status } from '../client/subscription.js';
import type { Shown } from '../core/playout.js';

// What the page says about a stream, in the words of the native client (client/hud_text.cpp).

const commas = (value: number): string => value.toLocaleString('en-US');

/** "4.1 of 11.3 MB" */
export function textFromDownload({ downloadedBytes, totalBytes }: Status['asset']): string {
  return `${(downloadedBytes / 1e6).toFixed(1)} of ${(totalBytes / 1e6).toFixed(1)} MB`;
}

export function textFromMode(profile: Required<Profile>): string {
  if (profile.rate === 'raw') return 'raw';
  return `${profile.rate} x${profile.k}${profile.scheme === 'linear' ? '' : ` ${profile.scheme}`}`;
}

/** Over the picture while nothing new comes; empty: nothing to say. */
export function bannerOf({ state, detail }: Status, newestMs: number | undefined, nowMs: number): string {
  if (newestMs === undefined || state === 'live' || state === 'downloading') return '';
  const since = `no data for ${((nowMs - newestMs) / 1000).toFixed(1)} s - `;
  if (state === 'stalled') return `${since}the sender is gone, this is its last pose`;
  if (state === 'waiting') return `${since}waiting for a sender`;
  if (state === 'refused') return `${since}refused: ${detail}`;
  return `${since}connection lost${detail === '' ? '' : `: ${detail}`}`;
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
  delayMs: number;
  workMs: number;
  load: number;
  bands: number;
  bandsTotal: number;
  rank: number;
}
export function figureLines(f: Figures): string[] {
  const ms = (value: number): string => `${value < 10 ? value.toFixed(1) : Math.round(value)} ms`;
  return [
    `${Math.round(f.keysHz)} keys/s · ${Math.round(f.posesHz)} poses/s · ${Math.round(f.drawnHz)} drawn/s`,
    `${Math.round(f.kbitPerS)} kbit/s · round trip ${f.roundTripMs === undefined ? 'not known yet' : ms(f.roundTripMs)}`,
    `LOD ${(f.verticesTotal === 0 ? 0 : f.vertices / f.verticesTotal).toFixed(2)} · ${commas(f.vertices)} of ${commas(f.verticesTotal)} vertices, ${f.faces === 0 ? 'points' : `${commas(f.faces)} faces`}`,
    f.profile ? textFromMode(f.profile) : '',
    `${f.shown} · ${ms(f.delayMs)} held back`,
    // Over twice a picture's time: not even the fewest vertices would hold the rate.
    `${ms(f.workMs)} a picture · ${f.load > 2 ? 'out of reach here' : `${Math.round(100 * f.load)} % planned`}`,
    `bands ${f.bands} of ${f.bandsTotal} · rank ${f.rank}`,
  ].filter((line) => line !== '');
}
