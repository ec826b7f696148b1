// SPDX-License-Identifier: MIT
import type { Broker, ListedStream, Stream } from '../client/client.js';
import type { Stage } from '../view/stage.js';
import type { View } from '../view/view.js';
import type { command, part } from './parts.js';
import type { pageOf, Place } from './place.js';

/** What the page has anyway: files that are loaded later, such as this one, are small if they share no modules with it. */
export interface Kit {
  View: typeof View;
  part: typeof part;
  command: typeof command;
  pageOf: typeof pageOf;
}

const EVERY_MS = 2000, ASPECT = 16 / 10;
/** Up to these widths, in pixels of the screen, a preview takes one band of its surface's first part, or two bands; up to the last, the page's, no shadow. */
const SMALL_PX = 400, MIDDLE_PX = 800, TILE_PX = 200;
/** Of all previews, in one memory of 4 GiB, whatever their manifests claim; and of one of few. */
const MAX_PREVIEWS = 128, ALL_BYTES = 3840 * 2 ** 20, MAX_BYTES = 160 * 2 ** 20;

interface Card {
  name: string;
  element: HTMLElement;
  picture: HTMLElement;
  state: HTMLElement;
  more: HTMLElement;
  isNear: boolean;
  bands: number;
  view?: View | undefined;
  stream?: Stream | undefined;
}

/** The streams of a broker, each with a small moving picture where it can be seen; or, as a wall, all of them at once. */
export class ListPage {
  readonly #place: Place;
  readonly #broker: Broker;
  readonly #stage: Stage | undefined;
  readonly #cards = new Map<string, Card>();
  readonly #kit: Kit;
  readonly #list: HTMLElement;
  readonly #empty: HTMLElement;
  readonly #main: HTMLElement;
  readonly #trouble: HTMLElement;
  readonly #wall: HTMLElement;
  readonly #isStill = matchMedia('(prefers-reduced-motion: reduce)').matches;
  readonly #near: IntersectionObserver;

  /** No stage: without pictures. */
  constructor(place: Place, broker: Broker, stage: Stage | undefined, kit: Kit) {
    const { part } = (this.#kit = kit);
    this.#place = place;
    this.#broker = broker;
    this.#stage = stage;
    this.#list = part('ul', { class: 'streams' });
    this.#trouble = part('p', { role: 'status' });
    this.#wall = part('button', { class: 'button', type: 'button', 'aria-pressed': 'false', onclick: () => this.#toggleWall() }, 'Wall');
    this.#empty = part('div', { hidden: true },
      part('p', {}, 'No streams yet. One appears here as soon as somebody publishes it, for example by'),
      kit.command(`eigencast-sender play heart --to ${place.base.replace(/^http/, 'ws')}/demo`));
    const wanted = part('input', { name: 'url', required: true, placeholder: 'Name or URL of a stream', 'aria-label': 'Name or URL of a stream', autocapitalize: 'off', spellcheck: 'false' });
    const open = part('form', {}, wanted, part('button', { class: 'button', type: 'submit' }, 'Open'), this.#wall, part('a', { class: 'button', href: new URL('show.html', import.meta.url).href }, 'Play a recording'));
    open.addEventListener('submit', (event) => {
      event.preventDefault();
      this.#open(wanted.value);
    });
    document.addEventListener('paste', (event) => {
      const text = event.clipboardData?.getData('text') ?? '';
      if (event.target !== wanted && text.includes('/')) this.#open(text);
    });
    this.#main = part('main', { class: 'list' }, part('h1', {}, 'Live surfaces'), part('p', {}, new URL(place.base).host), open, this.#trouble, this.#empty, this.#list);
    document.body.replaceChildren(this.#main);
    this.#near = new IntersectionObserver((entries) => {
      for (const { target, isIntersecting } of entries) {
        const card = [...this.#cards.values()].find(({ element }) => element === target);
        if (card) card.isNear = isIntersecting;
        if (card && !isIntersecting) this.#blank(card);
      }
      void this.#refresh();
    }, { rootMargin: '100%' });
    addEventListener('resize', () => this.#layOut());
    if (place.query.get('wall') === '1') this.#toggleWall();
  }
  /** Follows the broker's list from now on. */
  async run(): Promise<never> {
    for (;;) {
      if (!document.hidden) await this.#refresh();
      await new Promise((resolve) => setTimeout(resolve, EVERY_MS));
    }
  }

  #open(text: string): void {
    const url = this.#kit.pageOf(text.trim(), this.#place.base);
    if (url) location.href = url;
    else this.#trouble.textContent = `"${text.slice(0, 80)}" is no name and no URL of a stream`;
  }
  #toggleWall(): void {
    const isWall = this.#main.classList.toggle('wall'), address = new URL(location.href);
    this.#wall.setAttribute('aria-pressed', String(isWall));
    if (isWall) address.searchParams.set('wall', '1');
    else address.searchParams.delete('wall');
    history.replaceState(null, '', address);
    this.#layOut();
  }
  #layOut(): void {
    const isWall = this.#main.classList.contains('wall');
    this.#list.style.setProperty('--tile', `${tileWidth(this.#cards.size, innerWidth, innerHeight)}px`);
    // Where a picture has become larger it takes more of its stream.
    for (const card of this.#cards.values()) if (card.view && card.bands !== bandsFor(card.picture)) this.#blank(card);
    if (isWall || this.#cards.size > 0) void this.#refresh();
  }
  async #refresh(): Promise<void> {
    try {
      const streams = await this.#broker.streams(), before = this.#cards.size;
      this.#trouble.textContent = '';
      this.#empty.hidden = streams.length > 0;
      for (const card of [...this.#cards.values()]) if (!streams.some(({ stream }) => stream === card.name)) this.#remove(card);
      for (const stream of streams) this.#update(stream);
      if (this.#cards.size !== before) this.#layOut();
    } catch (error) {
      this.#trouble.textContent = `${(error as Error).message}; trying again`;
    }
  }
  #update({ stream, state, keyRateHz, subscribers }: ListedStream): void {
    const card = this.#cards.get(stream) ?? this.#add(stream);
    card.state.textContent = state;
    card.state.className = `state ${state}`;
    const watching = Math.max(0, subscribers - (card.stream ? 1 : 0));
    card.more.textContent = `${Number(keyRateHz.toPrecision(3))} keys/s · ${watching === 0 ? 'nobody else watches' : watching === 1 ? '1 viewer' : `${watching} viewers`}`;
    if (this.#stage && card.isNear && !card.view && state !== 'waiting' && this.#previews < MAX_PREVIEWS) this.#preview(card, this.#stage);
  }
  get #previews(): number {
    return [...this.#cards.values()].filter((card) => card.view).length;
  }
  #add(name: string): Card {
    const { part } = this.#kit, picture = part('div', { class: 'blank' }), state = part('dd', { class: 'state' }), more = part('dd', { class: 'more' });
    const element = part('li', {}, part('a', { href: `${this.#place.base}/${name}` }, picture, part('dl', {}, part('dt', {}, name), state, more)));
    const card = { name, element, picture, state, more, isNear: false, bands: 0 };
    this.#cards.set(name, card);
    this.#list.append(element);
    this.#near.observe(element);
    return card;
  }
  #remove(card: Card): void {
    this.#near.unobserve(card.element);
    this.#blank(card);
    card.element.remove();
    this.#cards.delete(card.name);
  }
  #replace(card: Card, picture: HTMLElement): void {
    card.picture.replaceWith(picture);
    card.picture = picture;
  }
  #blank(card: Card): void {
    if (!card.view) return;
    card.view.close();
    card.stream?.close();
    card.view = card.stream = undefined;
    this.#replace(card, this.#kit.part('div', { class: 'blank' }));
  }
  /** Moved by so many bands as its size shows; a small one is coarse. */
  #preview(card: Card, stage: Stage): void {
    const canvas = this.#kit.part('canvas', { 'aria-hidden': 'true' });
    this.#replace(card, canvas);
    card.bands = bandsFor(canvas);
    const maxBytes = Math.min(MAX_BYTES, ALL_BYTES / Math.min(this.#cards.size, MAX_PREVIEWS));
    card.stream = this.#broker.watch(card.name, { profile: { rate: 'raw', bands: card.bands }, maxBytes, isPreview: card.bands === 1 });
    card.view = new this.#kit.View(stage, canvas, card.stream);
    card.view.setStyle({ wall: false, grid: false, shadow: canvas.clientWidth > TILE_PX });
    if (this.#isStill) card.view.live.isPaused = true;
  }
}

function bandsFor({ clientWidth }: HTMLElement): number {
  const pixels = clientWidth * devicePixelRatio;
  return pixels <= SMALL_PX ? 1 : pixels <= MIDDLE_PX ? 2 : 8;
}

/** The largest width of `count` tiles of 16 by 10 that fill a window together, without scrolling. */
export function tileWidth(count: number, width: number, height: number): number {
  let widest = 0;
  for (let columns = 1; columns <= count; ++columns) widest = Math.max(widest, Math.min(width / columns, (ASPECT * height) / Math.ceil(count / columns)));
  return Math.floor(widest);
}
