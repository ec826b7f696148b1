// SPDX-License-Identifier: MIT
import type { Scheme } from '../core/frames.js';

/** What a viewer wants of a stream (protocol.md, section 2). */
export interface Profile {
  rate?: 'raw' | 'interpolated' | 'estimated';
  /** Poses per key interval unless raw: 2 to 15 (default 3). */
  k?: number;
  scheme?: Scheme;
  /** How many of the lowest bands: 1 to 8 (default: all). */
  bands?: number;
}

export function queryFrom(profile: Profile): string {
  const { rate = 'interpolated', bands = 8 } = profile;
  const made = rate === 'raw' ? [] : [`k=${profile.k ?? 3}`];
  if (rate !== 'raw' && profile.scheme !== undefined) made.push(`scheme=${profile.scheme}`);
  return [`rate=${rate}`, ...made, `bands=${bands}`].join('&');
}

/** As the `subscribe` message has it. */
export function messageFrom(profile: Profile): Profile {
  const { rate = 'interpolated', bands = 8, k = 3, scheme } = profile;
  if (rate === 'raw') return { rate, bands };
  return { rate, k, bands, ...(scheme === undefined ? {} : { scheme }) };
}
