// SPDX-License-Identifier: MIT
import type { Status } from '../client/subscription.js';

// What the page says about a stream, in the words of the native client (client/hud_text.cpp).

/** Over the picture while nothing new comes; empty: nothing to say. */
export function bannerOf({ state, detail }: Status, newestMs: number | undefined, nowMs: number): string {
  if (newestMs === undefined || state === 'live' || state === 'downloading') return '';
  const since = `no data for ${((nowMs - newestMs) / 1000).toFixed(1)} s - `;
  if (state === 'stalled') return `${since}the sender is gone, this is its last pose`;
  if (state === 'waiting') return `${since}waiting for a sender`;
  if (state === 'refused') return `${since}refused: ${detail}`;
  return `${since}connection lost${detail === '' ? '' : `: ${detail}`}`;
}
