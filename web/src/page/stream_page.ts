// SPDX-License-Identifier: MIT
import type { Broker, Stream } from '../client/client.js';
import type { Surface } from '../client/subscription.js';
import type { Stage } from '../view/stage.js';
import { View } from '../view/view.js';
import { COMMANDS, commandFor, type Command, type Desk } from './commands.js';
import type { Hud } from './hud.js';
import type { Note } from './note.js';
import { command, copy, icon, part } from './parts.js';
import { keepToken, linkOf, type Place } from './place.js';
import type { RoomWay } from './room.js';
import type { Recording } from './recording.js';
import { bannerOf } from './words.js';

const TURN_SECONDS = 12, SAID_MS = 4000, BANNER_MS = 200;
/** What goes with a surface is loaded behind its first picture, or where none comes so soon; and until then nobody reads that it comes. */
const SOON_MS = 500;

/** One stream, as large as the page. */
export class StreamPage implements Desk {
  readonly view: View;
  #controls: import('../view/controls.js').Controls | undefined;
  isTurning = false;
  hasLegend = true;
  readonly #place: Place;
  readonly #broker: Pick<Broker, 'retryNow'>;
  readonly #commands: Command[];
  readonly #stream: Stream;
  readonly #stage: Stage;
  #hud: Hud | undefined;
  #hasFigures = false;
  readonly #note = part('section', { class: 'note', hidden: true });
  #noted: Promise<Note> | undefined;
  readonly #state = part('span', { class: 'state' }, 'connecting');
  readonly #banner = part('div', { class: 'banner', role: 'status', hidden: true });
  readonly #main: HTMLElement;
  readonly #help = part('dialog', { 'aria-label': 'Help' });
  readonly #buttons = new Map<Command, HTMLButtonElement>();
  #said: { text: string; untilMs: number } | undefined;
  #turnedMs = 0;
  #isRecording = false;
  #recording: Recording | undefined;
  #legend: HTMLElement | undefined;
  #legendSays = '';

  constructor(place: Place, broker: Pick<Broker, 'retryNow'> & Partial<RoomWay>, stage: Stage, stream: Stream, commands = COMMANDS) {
    this.#commands = commands;
    this.#place = place;
    this.#broker = broker;
    this.#stage = stage;
    this.#stream = stream;
    const canvas = part('canvas', { tabindex: '0', role: 'img' });
    this.#main = part('main', { class: place.isEmbedded ? 'viewer embed' : 'viewer' }, canvas, this.#head(), this.#banner, this.#note, this.#tools(), this.#help);
    document.body.replaceChildren(this.#main);
    document.title = `${stream.name} - Eigencast`;
    this.view = new View(stage, canvas, stream);
    this.view.onImage = () => this.#showOwnColours('textured');
    const dark = matchMedia('(prefers-color-scheme: dark)'), setWall = (): void => this.view.setStyle({ wall: !dark.matches });
    dark.addEventListener('change', setWall);
    setWall();
    if (place.isEmbedded) {
      this.#main.append(part('a', { class: 'button open', href: linkOf(place), target: '_blank', rel: 'noopener' }, 'Open'));
    }
    stream.on('status', () => this.#onStatus());
    stream.on('surface', () => this.#onStatus());
    const fail = ({ message }: Error): void => this.#withNote((note) => note.fail('The stream cannot be shown', message));
    stream.on('error', fail);
    setInterval(() => (this.#refreshBanner(), void this.#refreshLegend()), BANNER_MS);
    document.addEventListener('keydown', (event) => this.#onKey(event));
    this.#onFirstSurface();
    this.#onStatus();
    if (stream.error) fail(stream.error);
    this.#refreshButtons();
    let isWaiting = true;
    const turn = (nowMs: number): void => {
      requestAnimationFrame(turn);
      this.#turntable(nowMs);
      if (!isWaiting || !(this.view.live.drawn || nowMs > SOON_MS)) return;
      isWaiting = false;
      this.#onStatus();
      void import('../view/controls.js').then(({ Controls }) => (this.#controls = new Controls(this.view)));
      if (broker.sendText) void import('./past.js').then(({ showPast }) => showPast(this, this.#commands, place, broker as RoomWay, stream, this.#main, part, icon));
    };
    requestAnimationFrame(turn);
  }

  get hasFigures(): boolean {
    return this.#hasFigures;
  }
  set hasFigures(are: boolean) {
    this.#hasFigures = are;
    void import('./hud.js').then(({ Hud }) => {
      if (this.#hasFigures === (this.#hud !== undefined)) return;
      this.#hud?.close();
      this.#hud = this.#hasFigures ? new Hud(this.#stage, this.view, part) : undefined;
      if (this.#hud) this.#main.append(this.#hud.element);
    });
  }
  say(text: string): void {
    this.#said = { text, untilMs: Date.now() + SAID_MS };
    this.#refreshBanner();
  }
  screenshot(wall: boolean): void {
    void this.view.picture(wall).then((blob) => (blob ? void this.#keep('screenshot', blob) : this.say('there is no picture yet')));
  }
  get isRecording(): boolean {
    return this.#isRecording;
  }
  set isRecording(is: boolean) {
    this.#isRecording = is;
    if (is) void this.#record();
    else this.#recording?.stop();
  }
  copyLink(): void {
    const link = linkOf(this.#place, this.view.camera);
    void copy(link).then((done) => this.say(done ? 'the link to this view is in the clipboard' : `the link to this view: ${link}`));
  }
  fullScreen(): void {
    const done = document.fullscreenElement ? document.exitFullscreen() : this.#main.requestFullscreen?.();
    done?.catch(() => this.say('full screen is not allowed here'));
  }
  help(): void {
    if (this.#help.open) return this.#help.close();
    void import('./help.js').then(({ helpOf }) => {
      this.#help.replaceChildren(part('button', { class: 'button', 'aria-label': 'Close', onclick: () => this.#help.close() }, icon('M6 6l12 12M18 6L6 18')), ...helpOf(this, this.#commands, part));
      if (!this.#help.open) this.#help.showModal();
    });
  }

  async #record(): Promise<void> {
    try {
      const recording = (this.#recording = new (await import('./recording.js')).Recording(this.view.canvas));
      if (!this.#isRecording) recording.stop();
      this.say('recording; K ends it');
      await this.#keep('film', await recording.film);
    } catch (error) {
      this.say((error as Error).message);
    }
    this.#recording = undefined;
    this.#isRecording = false;
    this.#refreshButtons();
  }
  /** By the browser's download. */
  async #keep(what: string, blob: Blob): Promise<void> {
    this.say(`${what}: ${(await import('./recording.js')).download(blob, this.#stream.name)}`);
  }

  #head(): HTMLElement {
    return part('header', { class: 'head' },
      part('a', { class: 'button', href: `${this.#place.base}/`, 'aria-label': 'All streams', title: 'All streams' }, icon('M14 5l-7 7 7 7')),
      part('div', { class: 'name' }, part('h1', {}, this.#stream.name), this.#state));
  }
  #tools(): HTMLElement {
    const tools = part('div', { class: 'tools', role: 'toolbar', 'aria-label': 'View' });
    for (const command of this.#commands) {
      if (command.icon === undefined) continue;
      const title = `${command.does} (${command.keys[0] === ' ' ? 'Space' : command.keys[0]})`;
      const button = part('button', { class: 'button', type: 'button', title, 'aria-label': command.does, onclick: () => this.#apply(command) }, icon(command.icon));
      this.#buttons.set(command, button);
      tools.append(button);
    }
    return tools;
  }
  #apply(command: Command): void {
    command.apply(this);
    this.#refreshButtons();
  }
  #refreshButtons(): void {
    for (const [command, button] of this.#buttons) if (command.isOn) button.setAttribute('aria-pressed', String(command.isOn(this)));
  }
  /** Where somebody types, or on a button, keys are theirs. */
  #onKey(event: KeyboardEvent): void {
    const at = event.target as Element;
    if (this.#help.open || at.matches('input, textarea') || (at.matches('button, a') && (event.key === 'Enter' || event.key === ' '))) return;
    const command = commandFor(event, this.#commands);
    if (command) this.#apply(command);
    else if (event.ctrlKey || event.altKey || event.metaKey || !this.#controls?.onKey(event)) return;
    event.preventDefault();
  }

  #onFirstSurface(): void {
    let { eye, target } = this.#place;
    const onSurface = ({ colours, isComplete }: Surface): void => {
      if (eye && target) this.view.camera.lookFrom(eye, target);
      eye = undefined;
      if (colours) this.#showOwnColours('own');
      if (colours || isComplete) stop();
    };
    const stop = this.#stream.on('surface', onSurface);
    if (this.#stream.surface) onSurface(this.#stream.surface);
  }
  /** Unless somebody has chosen. */
  #showOwnColours(colour: 'own' | 'textured'): void {
    if (/^(clay|own)$/.test(this.view.style.colour)) this.view.setStyle({ colour });
  }
  #onStatus(): void {
    const status = this.#stream.status, { view } = this;
    if (!status) return;
    if (this.#state.textContent !== status.state) {
      this.#state.textContent = status.state;
      this.#state.className = `state ${status.state}`;
    }
    this.#state.title = status.detail;
    view.canvas.setAttribute('aria-label', `${this.#stream.name}, a moving surface: ${status.detail || status.state}`);
    if (this.#stream.surface) {
      if (this.#noted) this.#withNote((note) => note.hide());
    } else if (!/^(connecting|downloading)$/.test(status.state) || performance.now() > SOON_MS) {
      this.#withNote((note) => note.show(status, linkOf({ ...this.#place, query: new URLSearchParams(), room: '' }), {
        retry: () => this.#broker.retryNow(),
        token: (token) => {
          keepToken(this.#place.base, token);
          location.reload();
        },
      }));
    }
  }
  /** Loaded where it has something to say. */
  #withNote(say: (note: Note) => void): void {
    void (this.#noted ??= import('./note.js').then(({ Note }) => new Note(this.#note, { part, command }))).then(say);
  }
  #refreshBanner(): void {
    const now = Date.now(), status = this.#stream.status;
    if (this.#said && now > this.#said.untilMs) this.#said = undefined;
    const text = this.#said?.text ?? (status ? bannerOf(status, this.view.live.newestMs, now) : '');
    this.#banner.hidden = text === '';
    if (this.#banner.textContent !== text) this.#banner.textContent = text;
  }
  async #refreshLegend(): Promise<void> {
    const legend = this.hasLegend ? this.view.legend : undefined, says = JSON.stringify(legend) ?? '';
    if (says === this.#legendSays) return;
    this.#legendSays = says;
    const made = legend && (await import('./legend.js')).legendOf(legend, part);
    if (says !== this.#legendSays) return;
    this.#legend?.remove();
    this.#legend = made;
    if (made) this.#main.append(made);
  }
  #turntable(nowMs: number): void {
    const seconds = (nowMs - this.#turnedMs) / 1000;
    this.#turnedMs = nowMs;
    if (!this.isTurning) return;
    this.view.camera.turn((seconds * 2 * Math.PI) / TURN_SECONDS);
    this.view.invalidate();
  }
}
