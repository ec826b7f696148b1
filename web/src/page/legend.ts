// SPDX-License-Identifier: MIT
import type { Legend } from '../view/numbers.js';
import type { part } from './parts.js';

type Part = typeof part;
const textOf = (value: number): string => String(Number(value.toPrecision(3)));

/** What colours stand for: their name, a bar, its ends and its middle. Larger values have the last colour, too. */
export function legendOf({ title, unit, low, high, colours }: Legend, part: Part): HTMLElement {
  const bar = part('div', { class: 'bar' }), at = [textOf(high) + '+' + (unit === '' ? '' : ` ${unit}`), textOf((low + high) / 2), textOf(low)];
  bar.style.background = `linear-gradient(to top, ${colours.join()})`;
  return part('figure', { class: 'legend' }, part('figcaption', {}, title), bar, part('ul', {}, ...at.map((text) => part('li', {}, text))));
}
