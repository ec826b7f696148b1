// SPDX-License-Identifier: MIT
import type { Stream } from '../client/client.js';
import type { StreamInfo } from '../client/control.js';
import { barOf, playerCommands, type Played } from '../recording/bar.js';
import type { LiveSurface } from '../view/live_surface.js';
import type { View } from '../view/view.js';
import type { Command, Desk } from './commands.js';
import type { icon as Icon, part as Part } from './parts.js';
import type { Place } from './place.js';
import type { RoomWay } from './room.js';

// What a broker keeps of a stream (protocol.md, "history" and "seek"), by the keys of recordings. As client/rewind_desk.cpp.
// Moments are microseconds since 1970 on the broker's clock.

const TURN_MS = 50, ASK_MS = 1000, ANSWER_MS = 3000, LED_MS = 2000;
/** The broker shows live what is a second old; where it does so unasked, further away than this, the connection is new. */
const LIVE_US = 1_200_000, NEAR_US = 3_000_000;
/** Followers who play need not be nearer. */
const LED_US = 500_000;
const MAX_SPANS = 64;
const NOTHING = 'the broker keeps nothing of this stream, or its token may not see it again (rewind)';
const STYLE = `
.tools > .timeline { position: static; flex: 1 0 100%; max-width: 900px; display: flex; gap: 10px; align-items: center; padding: 4px 4px; border-radius: 10px; background: var(--card); }
.timeline .track { position: relative; flex: 1; min-width: 60px; }
.timeline input { display: block; width: 100%; margin: 0; accent-color: var(--accent); }
.timeline .kept { height: 5px; margin: 0 8px 2px; border-radius: 2px; pointer-events: none; }
.timeline .time { min-width: 19ch; font: 12.5px/1.5 ui-monospace, monospace; font-variant-numeric: tabular-nums; white-space: nowrap; }
.timeline .button:disabled { opacity: .5; cursor: default; }
.kept-stream .tools > [aria-label=pause] { display: none; }
.kept-stream .legend, .kept-stream .banner { margin-bottom: 58px; }
.past .state:not(.behind) { display: none; }
.state.behind { color: var(--wait); }
@media (max-width: 520px) { .tools > .timeline .time { display: none; } }
`;

export interface Span {
  fromUs: number;
  toUs: number;
}
/** Where the one who leads in a room is; nothing: live. Speed 0: paused. */
export interface Led {
  atUs: number;
  speed: number;
}
type Shows = Pick<Stream, 'info'> & { live: Pick<LiveSurface, 'shownUs' | 'surface' | 'delayUs'> };
interface Wanted {
  atUs: number;
  speed: number;
  next: boolean;
}

/** Whole microseconds since 1970, far from where numbers are exact no more. */
const isTime = (value: unknown): value is number => Number.isSafeInteger(value) && (value as number) >= 0;

/** "12.3 s behind live", "3:07 behind live", "1:02:07 behind live": as the native client says it. */
export function textFromBehind(us: number): string {
  const tenths = Math.floor(Math.max(0, us) / 100_000), s = Math.floor(tenths / 10), two = (value: number): string => String(value).padStart(2, '0');
  const time = s >= 3600 ? `${Math.floor(s / 3600)}:${two(Math.floor(s / 60) % 60)}:${two(s % 60)}` : s >= 60 ? `${Math.floor(s / 60)}:${two(s % 60)}` : `${s}.${tenths % 10} s`;
  return `${time} behind live`;
}

/** Between marks of so long a past: a dozen at most. */
export function markUs(lengthUs: number): number {
  return 1e6 * ([1, 5, 30, 60, 300, 600].find((seconds) => lengthUs <= 12e6 * seconds) ?? 3600);
}

/** Which moment is shown, and what the broker is asked for. Time comes in as milliseconds. */
export class Rewinder implements Played {
  spans: Span[] = [];
  /** The picture is to stay: it is paused where it was, between poses too. */
  holds = false;
  isPast = false;
  atUs = 0;
  nowUs = 0;
  /** Of something that was not done, for people; taken by who says it. */
  trouble = '';
  /** Changes with what the user does, and every two seconds while it plays. */
  led: Led | undefined;
  readonly #shows: Shows;
  readonly #send: (message: object) => void;
  readonly #subscribe: () => void;
  #why = NOTHING;
  #heard: { nowUs: number; atMs: number } | undefined;
  #isPaused = false;
  #speed = 1;
  #steps = 0;
  #wanted: Wanted | undefined;
  #asked: { epoch: number | undefined } | undefined;
  #sentMs = -Infinity;
  #askedMs = -Infinity;
  #ledMs = -Infinity;

  /** subscribe: back to live */
  constructor(shows: Shows, send: (message: object) => void, subscribe: () => void) {
    this.#shows = shows;
    this.#send = send;
    this.#subscribe = subscribe;
  }
  get hasPast(): boolean {
    return this.spans.length > 0;
  }
  get #fromUs(): number {
    return this.spans[0]?.fromUs ?? this.nowUs;
  }
  get #isBehind(): boolean {
    return this.isPast || this.#isPaused;
  }
  get positionUs(): number {
    return (this.#isBehind ? this.atUs : this.nowUs) - this.#fromUs;
  }
  get durationUs(): number {
    return this.nowUs - this.#fromUs;
  }
  /** What is shown is what was wanted. */
  get isSettled(): boolean {
    return !this.#wanted && !this.#asked && this.#steps === 0;
  }
  get says(): string {
    return this.#isBehind ? textFromBehind(this.nowUs - this.atUs) : 'live';
  }
  get isPlaying(): boolean {
    return !this.#isPaused;
  }
  set isPlaying(is: boolean) {
    if (is !== this.#isPaused) return;
    this.#isPaused = !is;
    this.holds = !is;
    if (is || this.isPast) this.#go(this.atUs);
  }
  get speed(): number {
    return this.#speed;
  }
  /** Nothing comes faster than live. */
  set speed(speed: number) {
    if (!this.hasPast) this.trouble ||= this.#why;
    if (!this.hasPast || speed === this.#speed || (!this.isPast && speed > 1)) return;
    this.#speed = speed;
    if (!this.#isPaused) this.#go(this.atUs);
  }
  get #told(): number {
    return this.#isPaused ? 0 : this.#speed;
  }
  seek(timeUs: number): void {
    this.holds = false;
    this.#steps = 0;
    this.#go(this.#fromUs + timeUs);
  }
  step(by: 1 | -1): void {
    if (!this.hasPast) return void (this.trouble ||= this.#why);
    this.#isPaused = this.isPast = true;
    this.holds = false;
    this.#steps += by;
  }
  /** Back to it. */
  live(): void {
    const wasPast = this.isPast;
    this.#end();
    if (wasPast) this.#subscribe();
  }
  follow(led: Led | undefined): void {
    if (!this.hasPast) return;
    if (!led) return this.live();
    if (this.isPast && this.#told === led.speed && Math.abs(led.atUs - this.atUs) <= (led.speed === 0 ? 0 : LED_US)) return;
    this.#isPaused = led.speed === 0;
    if (led.speed > 0) this.#speed = led.speed;
    this.holds = false;
    this.#go(led.atUs);
  }

  /** A text of the broker; nothing: the connection is new. */
  hear(text: string, nowMs: number): void {
    if (text === '') return void ([this.#heard, this.#askedMs] = [undefined, -Infinity]);
    if (!text.includes('"op":"history"')) return;
    let said: { [name: string]: unknown } = {};
    try {
      said = JSON.parse(text);
    } catch (error) {
      console.warn(`eigencast: history: ${(error as Error).message}`);
    }
    const { stream, now_us, spans, code, message } = said;
    if (stream !== this.#shows.info?.stream) return;
    const all = (Array.isArray(spans) ? spans.slice(0, MAX_SPANS) : []).map((one) => ({ fromUs: Object(one).from_us as unknown, toUs: Object(one).to_us as unknown }));
    this.spans = all.filter((span): span is Span => isTime(span.fromUs) && isTime(span.toUs) && span.fromUs <= span.toUs).sort((a, b) => a.fromUs - b.fromUs);
    if (isTime(now_us)) this.#heard = { nowUs: (this.nowUs = now_us), atMs: nowMs };
    this.#why = code ? `${message} (${code})` : NOTHING;
    if (!code || !this.#asked) return;
    this.trouble = this.#why;
    this.#asked = undefined;
    if (!this.#shows.info?.rewind) this.#end();
  }
  /** Once a turn. */
  turn(nowMs: number): void {
    const { info, live } = this.#shows, heard = this.#heard;
    if (nowMs - this.#askedMs >= ASK_MS && info) {
      this.#askedMs = nowMs;
      this.#send({ op: 'history', stream: info.stream });
    }
    if (!heard || !info || !this.hasPast) return;
    this.nowUs = heard.nowUs + 1000 * (nowMs - heard.atMs);
    this.#follow(nowMs);
    if (!this.#isBehind) this.atUs = this.nowUs - live.delayUs;
    const isSettled = !this.#wanted && !this.#asked;
    if (this.isPast && isSettled && !this.holds && info.rewind) this.atUs = this.#momentUs(info.rewind);
    if (this.#steps !== 0 && isSettled) {
      this.#wanted = this.#steps < 0 ? { atUs: this.atUs - 1, speed: 0, next: false } : { atUs: this.atUs, speed: 0, next: true };
      this.#steps -= Math.sign(this.#steps);
    }
    this.#flush(nowMs);
    if (!this.#isBehind) this.led = undefined;
    else if (this.#sentMs === nowMs || nowMs - this.#ledMs >= LED_MS) [this.led, this.#ledMs] = [{ atUs: Math.round(this.atUs), speed: this.#told }, nowMs];
  }
  #momentUs({ at_us, capture_us, speed }: NonNullable<StreamInfo['rewind']>): number {
    const { info, live } = this.#shows, shownUs = live.surface?.epoch === info?.epoch ? live.shownUs : undefined;
    return Number(at_us) + (shownUs === undefined ? 0 : Number(shownUs - capture_us) * speed);
  }
  #follow(nowMs: number): void {
    const { info } = this.#shows, showsPast = info?.rewind !== undefined;
    if (this.#wanted || (this.#asked && info?.epoch === this.#asked.epoch && nowMs - this.#sentMs < ANSWER_MS)) return;
    const wasAsked = this.#asked !== undefined;
    this.#asked = undefined;
    if (!this.isPast || showsPast || this.#steps !== 0) return;
    if (wasAsked || this.nowUs - this.atUs < NEAR_US) this.#end();
    else this.#go(this.atUs);
  }
  #go(atUs: number): void {
    if (this.#told >= 1 && atUs > this.nowUs - LIVE_US) return this.live();
    this.isPast = true;
    this.atUs = atUs;
    this.#wanted = { atUs, speed: this.#told, next: false };
  }
  #end(): void {
    this.isPast = this.holds = this.#isPaused = false;
    this.#speed = 1;
    this.#steps = 0;
    this.#wanted = this.#asked = undefined;
  }
  #flush(nowMs: number): void {
    const { info } = this.#shows, wanted = this.#wanted;
    if (!wanted || !info || nowMs - this.#sentMs < TURN_MS) return;
    this.#sentMs = nowMs;
    this.#wanted = undefined;
    this.#asked = { epoch: info.epoch };
    this.#send({ op: 'seek', stream: info.stream, at_us: Math.max(0, Math.round(wanted.atUs)), speed: wanted.speed, ...(wanted.next ? { next: true } : {}) });
  }
}

/** The strip below the bar: what is kept, gaps, and marks of time before now. */
function stripOf({ spans, nowUs }: Rewinder): string {
  const fromUs = spans[0]!.fromUs, lengthUs = Math.max(nowUs - fromUs, 1), percent = (us: number): string => `${(100 * us / lengthUs).toFixed(2)}%`;
  const kept = spans.map((span) => [percent(span.fromUs - fromUs), percent(span.toUs - fromUs)]).map(([a, b]) => `transparent ${a}, var(--quiet) ${a} ${b}, transparent ${b}`);
  return `repeating-linear-gradient(to left, transparent 0 calc(${percent(markUs(lengthUs))} - 2px), var(--card) 0 ${percent(markUs(lengthUs))}), linear-gradient(to right, ${kept.join(', ')}), var(--line)`;
}

/** Puts a timeline on the page of a stream whose broker keeps it, and its keys before the page's; in a room follows who leads. */
export function showPast(desk: Desk, commands: Command[], place: Place, broker: RoomWay, stream: Stream, main: HTMLElement, part: typeof Part, icon: typeof Icon): Rewinder {
  const { live }: View = desk.view, shows = { get info() { return stream.info; }, live };
  const rewinder = new Rewinder(shows, (message) => broker.sendText(JSON.stringify(message)), () => (stream.pause(), stream.resume()));
  broker.onText.add((text) => rewinder.hear(text, performance.now()));
  if (place.room !== '') void import('./room.js').then(({ RoomDesk }) => new RoomDesk(place, broker, stream, desk.view, main, part, rewinder));
  const own = playerCommands(rewinder), pause = own.shift()!, end: Command = { keys: ['End'], does: 'back to live', apply: () => rewinder.live() };
  commands.unshift(...own);
  const strip = part('div', { class: 'kept' }), behind = part('span', { class: 'state behind' });
  const back = part('button', { class: 'button', type: 'button', title: 'Back to live (End)', onclick: () => rewinder.live() }, 'Live');
  let bar: HTMLElement | undefined;
  const show = (): void => {
    const sheet = new CSSStyleSheet();
    sheet.replaceSync(STYLE);
    document.adoptedStyleSheets = [...document.adoptedStyleSheets, sheet];
    main.classList.add('kept-stream');
    // The page's buttons stay.
    for (const mine of [pause, end]) Object.assign(commands.find(({ keys }) => keys[0] === mine.keys[0])!, { isOn: undefined, ...mine });
    bar = barOf(rewinder, part, icon, back);
    bar.querySelector('input')!.after(strip);
    main.querySelector('.tools')!.prepend(bar);
    main.querySelector('.name')!.append(behind);
  };
  const turn = (): void => {
    rewinder.turn(performance.now());
    if (rewinder.trouble !== '') desk.say(rewinder.trouble);
    rewinder.trouble = '';
    if (!rewinder.hasPast) return;
    if (!bar) show();
    const isBehind = rewinder.says !== 'live', drawn = stripOf(rewinder);
    if (live.isPaused !== rewinder.holds) live.isPaused = rewinder.holds;
    if (strip.style.background !== drawn) strip.style.background = drawn;
    behind.textContent = isBehind ? rewinder.says : '';
    behind.title = new Date(rewinder.atUs / 1000).toISOString();
    bar!.setAttribute('aria-busy', String(!rewinder.isSettled));
    behind.hidden = back.disabled = !isBehind;
    main.classList.toggle('past', isBehind);
  };
  setInterval(turn, TURN_MS);
  for (const name of ['input', 'click', 'keydown']) document.addEventListener(name, turn);  // At once, behind those who act on it.
  return rewinder;
}
