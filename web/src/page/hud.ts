// SPDX-License-Identifier: MIT
import type { Status } from '../client/subscription.js';
import type { Stage } from '../view/stage.js';
import type { View } from '../view/view.js';
import { figureLines, utcOf } from './figures.js';
import type { part } from './parts.js';

const EVERY_MS = 500;
/** Rates are those of so many refreshes. */
const WINDOW = 5;

interface Counted {
  atMs: number;
  keys: number;
  poses: number;
  drawn: number;
  bytes: number;
}

/** Figures over the picture; loaded when they are asked for. */
export class Hud {
  readonly element: HTMLElement;
  readonly #stage: Stage;
  readonly #view: View;
  readonly #timer: ReturnType<typeof setInterval>;
  #before: Counted[] = [];
  readonly #part: typeof part;

  constructor(stage: Stage, view: View, make: typeof part) {
    this.element = make('ul', { class: 'figures', 'aria-label': 'Figures' });
    this.#part = make;
    this.#stage = stage;
    this.#view = view;
    this.#timer = setInterval(() => this.#refresh(), EVERY_MS);
  }
  close(): void {
    clearInterval(this.#timer);
    this.element.remove();
  }

  #refresh(): void {
    const { live } = this.#view, { status, info } = live.stream, facts = live.surface?.facts;
    const now = this.#counted(status), before = this.#before[0] ?? now;
    this.#before = [...this.#before, now].slice(-WINDOW);
    this.element.hidden = !facts || !status;
    if (!facts || !status) return;
    const perSecond = (name: keyof Counted): number => (1000 * (now[name] - before[name])) / Math.max(now.atMs - before.atMs, 1);
    const isNew = live.surface?.epoch === info?.epoch, utcUs = info && live.shownUs !== undefined && isNew ? utcOf(info, live.shownUs) : undefined;
    const lines = figureLines({
      keysHz: perSecond('keys'), posesHz: perSecond('poses'), drawnHz: perSecond('drawn'), kbitPerS: (8 * perSecond('bytes')) / 1000,
      roundTripMs: status.clock && status.clock.roundTripUs / 1000, vertices: this.#view.vertices, verticesTotal: facts.vertexCount,
      faces: this.#view.faces, profile: info?.profile, shown: live.shown, utcUs, delayMs: live.delayUs / 1000, workMs: this.#stage.workMs,
      load: this.#stage.load, bands: bitsOf(live.bands), bandsTotal: facts.bandEnds.length, rank: facts.rank,
    });
    this.element.replaceChildren(...lines.map((line) => this.#part('li', {}, line)));
  }
  #counted(status: Status | undefined): Counted {
    const counts = status?.counts;
    return {
      atMs: performance.now(), keys: (counts?.keys ?? 0) + (counts?.joins ?? 0), poses: (counts?.keys ?? 0) + (counts?.joins ?? 0) + (counts?.synthetic ?? 0),
      drawn: this.#view.drawn, bytes: status?.bytes ?? 0,
    };
  }
}

function bitsOf(bands: number): number {
  return [0, 1, 2, 3, 4, 5, 6, 7].filter((band) => bands & (1 << band)).length;
}
