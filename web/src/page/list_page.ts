// SPDX-License-Identifier: MIT
import type { Broker, ListedStream, Stream } from '../client/client.js';
import type { Stage } from '../view/stage.js';
import { View } from '../view/view.js';
import { command, part } from './parts.js';
import type { Place } from './place.js';

const EVERY_MS = 2000, MAX_PREVIEWS = 24;
/** Of one, so that all have room in one memory of 4 GiB, whatever their manifests claim. */
const MAX_BYTES = 160 * 2 ** 20;

interface Card {
  element: HTMLElement;
  picture: HTMLElement;
  state: HTMLElement;
  more: HTMLElement;
  view?: View;
  stream?: Stream;
}

/** The streams of a broker, each with a small moving picture. */
export class ListPage {
  readonly #place: Place;
  readonly #broker: Broker;
  readonly #stage: Stage | undefined;
  readonly #cards = new Map<string, Card>();
  readonly #list = part('ul', { class: 'streams' });
  readonly #empty: HTMLElement;
  readonly #trouble = part('p', { role: 'status' });
  readonly #isStill = matchMedia('(prefers-reduced-motion: reduce)').matches;

  /** No stage: without pictures. */
  constructor(place: Place, broker: Broker, stage: Stage | undefined) {
    this.#place = place;
    this.#broker = broker;
    this.#stage = stage;
    this.#empty = part('div', { hidden: true },
      part('p', {}, 'No streams yet. One appears here as soon as somebody publishes it, for example by'),
      command(`eigencast-sender play heart --to ${place.base.replace(/^http/, 'ws')}/demo`));
    document.body.replaceChildren(part('main', { class: 'list' },
      part('h1', {}, 'Live surfaces'), part('p', {}, new URL(place.base).host), this.#trouble, this.#empty, this.#list));
  }
  /** Follows the broker's list from now on. */
  async run(): Promise<never> {
    for (;;) {
      if (!document.hidden) await this.#refresh();
      await new Promise((resolve) => setTimeout(resolve, EVERY_MS));
    }
  }

  async #refresh(): Promise<void> {
    try {
      const streams = await this.#broker.streams();
      this.#trouble.textContent = '';
      this.#empty.hidden = streams.length > 0;
      for (const [name, card] of this.#cards) if (!streams.some(({ stream }) => stream === name)) this.#remove(name, card);
      for (const stream of streams) this.#update(stream);
    } catch (error) {
      this.#trouble.textContent = `${(error as Error).message}; trying again`;
    }
  }
  #update({ stream, state, keyRateHz, subscribers }: ListedStream): void {
    const card = this.#cards.get(stream) ?? this.#add(stream);
    card.state.textContent = state;
    card.state.className = `state ${state}`;
    const watching = subscribers - (card.stream ? 1 : 0);
    card.more.textContent = `${Number(keyRateHz.toPrecision(3))} keys/s · ${watching === 0 ? 'nobody else watches' : watching === 1 ? '1 viewer' : `${watching} viewers`}`;
    if (this.#stage && !card.view && state !== 'waiting' && this.#previews < MAX_PREVIEWS) this.#preview(stream, card, this.#stage);
  }
  get #previews(): number {
    return [...this.#cards.values()].filter((card) => card.view).length;
  }
  #add(name: string): Card {
    const picture = part('div', { class: 'blank' }), state = part('dd', { class: 'state' }), more = part('dd', { class: 'more' });
    const element = part('li', {}, part('a', { href: `${this.#place.base}/${name}` }, picture, part('dl', {}, part('dt', {}, name), state, more)));
    const card = { element, picture, state, more };
    this.#cards.set(name, card);
    this.#list.append(element);
    return card;
  }
  #remove(name: string, card: Card): void {
    card.view?.close();
    card.stream?.close();
    card.element.remove();
    this.#cards.delete(name);
  }
  /** Its first, coarse part, moved by the lowest band. */
  #preview(name: string, card: Card, stage: Stage): void {
    const canvas = part('canvas', { 'aria-hidden': 'true' });
    card.picture.replaceWith(canvas);
    card.picture = canvas;
    card.stream = this.#broker.watch(name, { profile: { rate: 'raw', bands: 1 }, maxBytes: MAX_BYTES, isPreview: true });
    card.view = new View(stage, canvas, card.stream);
    card.view.setStyle({ wall: false, grid: false });
    if (this.#isStill) card.view.live.isPaused = true;
  }
}
