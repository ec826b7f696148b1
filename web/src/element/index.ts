// SPDX-License-Identifier: MIT
/**
 * <eigencast-view src="https://host/lab/horse"></eigencast-view> for anybody's page: importing this file defines it.
 *
 * src      the stream's URL; its query says the profile. A token: property `token`. Or that of a recording (.ecrec), which
 *          plays again and again
 * colour   clay (default), own, textured, normals, movement, speed, channel:NAME
 * still    no camera controls
 * preview  the first, coarse part of the surface is enough
 * Of recordings, as of <video>: play(), pause(), paused, currentTime, duration, playbackRate, loop.
 * Events: status (detail: Status), error (detail: EigencastError). Elements share one GL context, and those of one
 * broker one connection.
 */
import { workerAt, type Stream } from '../client/client.js';
import { defaults } from '../client/defaults.js';
import { profileIn } from '../client/query.js';
import { surroundings } from '../client/environment.js';
import { shared } from '../client/shared.js';
import { locatedUrl } from '../client/url.js';
import { EigencastError } from '../core/module.js';
import type { Player } from '../recording/player.js';
import { Controls } from '../view/controls.js';
import { Stage } from '../view/stage.js';
import { colouringIn } from '../view/style.js';
import { View } from '../view/view.js';

const STYLE = `
  :host { display: block; position: relative; aspect-ratio: 16 / 10; background: linear-gradient(#9eafbf, #e9ebee); }
  canvas { display: block; width: 100%; height: 100%; }
  canvas:focus-visible { outline: 3px solid #a33c26; outline-offset: -3px; }
  p { position: absolute; left: 8px; bottom: 8px; margin: 0; padding: 4px 10px; max-width: calc(100% - 16px); border-radius: 8px; background: #ffffffd9; color: #1a222b; font: 13px/1.4 system-ui, sans-serif; }
  p:empty { display: none; }`;

let stage: Promise<Stage> | undefined;

export class EigencastView extends HTMLElement {
  static readonly observedAttributes = ['src', 'colour', 'still', 'preview'];
  /** Presented to the broker; set it before src. Attributes would show it to everybody. */
  token = '';
  readonly #canvas = document.createElement('canvas');
  readonly #said = document.createElement('p');
  #view: View | undefined;
  #player: Player | undefined;
  #stop: (() => void) | undefined;
  #opened = 0;

  constructor() {
    super();
    const root = this.attachShadow({ mode: 'open' }), sheet = new CSSStyleSheet();
    sheet.replaceSync(STYLE);
    root.adoptedStyleSheets = [sheet];
    this.#canvas.setAttribute('role', 'img');
    this.#said.setAttribute('role', 'status');
    root.append(this.#canvas, this.#said);
  }
  connectedCallback(): void {
    void this.#open();
  }
  disconnectedCallback(): void {
    this.#close();
  }
  attributeChangedCallback(name: string): void {
    if (name === 'colour') this.#setColour();
    else if (this.isConnected) void this.#open();
  }

  /** Nothing before its stream is watched: camera, style, picture(). */
  get view(): View | undefined {
    return this.#view;
  }
  get stream(): Stream | undefined {
    return this.#view?.live.stream;
  }
  play(): void {
    if (this.#player) this.#player.isPlaying = true;
  }
  pause(): void {
    if (this.#player) this.#player.isPlaying = false;
  }
  get paused(): boolean {
    return this.#player?.isPlaying === false;
  }
  /** Seconds since the recording began. */
  get currentTime(): number {
    return (this.#player?.positionUs ?? 0) / 1e6;
  }
  set currentTime(seconds: number) {
    this.#player?.seek(1e6 * finite(seconds));
  }
  /** NaN before it is known; Infinity of a stream. */
  get duration(): number {
    return this.#player ? this.#player.durationUs / 1e6 : this.#view ? Infinity : NaN;
  }
  get playbackRate(): number {
    return this.#player?.speed ?? 1;
  }
  /** 0.1 to 10 */
  set playbackRate(speed: number) {
    if (this.#player) this.#player.speed = Math.min(Math.max(finite(speed), 0.1), 10);
  }
  get loop(): boolean {
    return this.#player?.isLooping ?? false;
  }
  set loop(is: boolean) {
    if (this.#player) this.#player.isLooping = is;
  }

  async #open(): Promise<void> {
    this.#close();
    const src = this.getAttribute('src'), mine = ++this.#opened;
    if (!src) return;
    let leave = (): void => {};
    try {
      const url = new URL(src, document.baseURI);
      if (url.pathname.endsWith('.ecrec')) {
        const { openRecording } = await import('../recording/player.js');
        if (mine !== this.#opened) return;
        const { stream, player, module } = await openRecording(url.href, workerAt(defaults.worker));
        leave = () => stream.close();
        const drawn = await (stage ??= Stage.make(module));
        if (mine !== this.#opened) return leave();
        this.#player = player;
        return this.#watch(drawn, stream, () => {});
      }
      const { broker: where, stream: name, query } = await locatedUrl(url.href, this.token, surroundings());
      if (mine !== this.#opened) return;
      const connection = shared(where, name);
      leave = connection.leave;
      const broker = await connection.broker, drawn = await (stage ??= Stage.make(broker.module));
      if (mine !== this.#opened) return leave();
      this.#watch(drawn, broker.watch(name, { profile: profileIn(query), isPreview: this.hasAttribute('preview') }), leave);
    } catch (error) {
      leave();
      if (mine === this.#opened) this.#fail(error instanceof EigencastError ? error : new EigencastError('internal', (error as Error).message));
    }
  }
  #watch(drawn: Stage, stream: Stream, leave: () => void): void {
    const view = (this.#view = new View(drawn, this.#canvas, stream)), controls = this.hasAttribute('still') ? undefined : new Controls(view);
    this.#canvas.tabIndex = controls ? 0 : -1;
    this.#canvas.onkeydown = (event) => {
      if (event.ctrlKey || event.altKey || event.metaKey) return;
      const isPause = event.key === ' ' && this.#player;
      if (isPause) this.#player!.isPlaying = this.paused;
      if (isPause || controls?.onKey(event)) event.preventDefault();
    };
    this.#setColour();
    stream.on('status', (status) => {
      this.#say(status.state === 'live' ? '' : status.detail || status.state);
      this.#canvas.setAttribute('aria-label', `${stream.name}, a moving surface: ${status.detail || status.state}`);
      this.dispatchEvent(new CustomEvent('status', { detail: status }));
    });
    stream.on('error', (error) => this.#fail(error));
    this.#stop = () => {
      controls?.close();
      view.close();
      stream.close();
      leave();
    };
  }
  #close(): void {
    ++this.#opened;
    this.#stop?.();
    this.#stop = this.#view = this.#player = undefined;
  }
  #setColour(): void {
    this.#view?.setStyle({ colour: colouringIn(this.getAttribute('colour')) ?? 'clay' });
  }
  #say(text: string): void {
    if (this.#said.textContent !== text) this.#said.textContent = text;
  }
  #fail(error: EigencastError): void {
    this.#say(error.message);
    this.dispatchEvent(new CustomEvent('error', { detail: error }));
  }
}

function finite(value: number): number {
  if (Number.isFinite(value)) return value;
  throw new TypeError(`a finite number is needed, not ${value}`);
}

customElements.define('eigencast-view', EigencastView);
