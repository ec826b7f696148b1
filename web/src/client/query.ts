// SPDX-License-Identifier: MIT
import type { Scheme } from '../core/frames.js';
import { EigencastError } from '../core/module.js';
import type { Profile } from './profile.js';

// Loaded by a page whose address asks for a profile.

const SCHEMES: readonly Scheme[] = ['linear', 'catmull-rom', 'hermite', 'damped'];
const CHOICES: Record<string, readonly string[]> = {
  rate: ['raw', 'interpolated', 'estimated'], scheme: SCHEMES,
};

/** What a URL's query asks for. A broker's refusal of a WebSocket has no words in browsers, so it is checked here. */
export function profileIn(query: URLSearchParams): Profile {
  const profile: Record<string, string | number> = {};
  const refuse = (why: string): never => {
    throw new EigencastError('invalid-argument', `profile: ${why}`);
  };
  for (const [name, value] of query) {
    const number = Number(value), isWhole = /^\d{1,2}$/.test(value), choices = Object.hasOwn(CHOICES, name) ? CHOICES[name] : undefined;
    if (name === 'k' || name === 'bands') profile[name] = isWhole ? number : refuse(`${name} must be a whole number`);
    else if (!choices) refuse(`unknown parameter '${name.slice(0, 32)}'; known: rate, k, scheme, bands`);
    else if (name === 'rate' && isWhole) Object.assign(profile, number === 1 ? { rate: 'raw' } : { rate: 'interpolated', k: number });
    else profile[name] = choices.includes(value) ? value : refuse(`${name} is '${value.slice(0, 32)}'; known: ${choices.join(', ')}`);
  }
  return profile as Profile;
}
