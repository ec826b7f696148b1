// SPDX-License-Identifier: MIT
import type { ConnectOptions, Stream, WatchOptions } from '../client/client.js';
import { profileIn } from '../client/query.js';
import { surroundings } from '../client/environment.js';
import { shared } from '../client/shared.js';
import type { Status, Surface } from '../client/subscription.js';
import { locatedUrl } from '../client/url.js';
import { Core, EigencastError } from '../core/module.js';
import { LiveSurface, type Drawn } from '../view/live_surface.js';

const IDLE_MS = 2000;

export interface FeedOptions extends Pick<ConnectOptions, 'token' | 'core' | 'worker'>, WatchOptions {
  /** The part of its vertices that is drawn, 0 to 1 (default: 1); may be set later. */
  detail?: number;
}
/** What a renderer hears. */
export interface FeedHooks {
  drawn(drawn: Drawn, surface: Surface): void;
  status(status: Status): void;
  error(error: EigencastError): void;
  /** A PNG or JPEG. */
  image(image: Uint8Array): void;
  surface(surface: Surface): void;
}

/** Centre and radius of a sphere, and corners of a box, around points. */
export interface Bounds {
  low: [number, number, number];
  high: [number, number, number];
  centre: [number, number, number];
  radius: number;
}
export function boundsOf(positions: Float32Array, margin = 0): Bounds {
  const low: [number, number, number] = [Infinity, Infinity, Infinity], high: [number, number, number] = [-Infinity, -Infinity, -Infinity];
  for (let i = 0; i < positions.length; i += 3) {
    for (let axis = 0; axis < 3; ++axis) {
      const value = positions[i + axis]!;
      if (value < low[axis]!) low[axis] = value;
      if (value > high[axis]!) high[axis] = value;
    }
  }
  const centre: [number, number, number] = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, (low[2] + high[2]) / 2];
  let most = 0;
  for (let i = 0; i < positions.length; i += 3) {
    const x = positions[i]! - centre[0], y = positions[i + 1]! - centre[1], z = positions[i + 2]! - centre[2];
    most = Math.max(most, x * x + y * y + z * z);
  }
  for (let axis = 0; axis < 3; ++axis) [low[axis], high[axis]] = [low[axis]! - margin, high[axis]! + margin];
  return { low, high, centre, radius: Math.sqrt(most) + margin };
}

const cores = new WeakMap<WebAssembly.Module, Promise<Core>>();
function coreOf(module: WebAssembly.Module): Promise<Core> {
  const core = cores.get(module) ?? Core.make(module);
  cores.set(module, core);
  return core;
}

/**
 * A stream for another renderer: opens its URL, plays it out, and hands arrays over. No poses come while advance() is
 * not called, as on a hidden page. Feeds of one broker share a connection.
 */
export class Feed {
  detail: number;
  /** With UVs, where the surface has an image. */
  isTextured = false;
  readonly #hooks: FeedHooks;
  #live: LiveSurface | undefined;
  #advancedMs = performance.now();
  #isPaused = false;
  #isClosed = false;
  #timer: ReturnType<typeof setInterval> | undefined;
  #end = (): void => {};

  constructor(url: string, options: FeedOptions, hooks: FeedHooks) {
    this.detail = options.detail ?? 1;
    this.#hooks = hooks;
    void this.#open(url, options).catch((error: unknown) => {
      this.#end();
      if (!this.#isClosed) hooks.error(error instanceof EigencastError ? error : new EigencastError('internal', (error as Error).message));
    });
  }
  /** Nothing before the broker's address is known. */
  get stream(): Stream | undefined {
    return this.#live?.stream;
  }
  get live(): LiveSurface | undefined {
    return this.#live;
  }
  /** Before each picture: the pose of the moment is asked for; `drawn` follows. */
  advance(): void {
    this.#advancedMs = performance.now();
    this.#pause(false);
    const live = this.#live, surface = live?.surface;
    if (!live || !surface) return;
    live.isTextured = this.isTextured;
    const { baseCount, vertexCount } = surface.facts;
    live.advance(Math.round((performance.timeOrigin + performance.now()) * 1000), Math.max(baseCount, Math.round(this.detail * vertexCount)));
  }
  close(): void {
    this.#isClosed = true;
    clearInterval(this.#timer);
    this.#live?.close();
    this.#end();
    this.#end = () => {};
  }

  async #open(url: string, options: FeedOptions): Promise<void> {
    const absolute = new URL(url, globalThis.document?.baseURI ?? globalThis.location?.href).href;
    const { broker: where, stream: name, query } = await locatedUrl(absolute, options.token, surroundings());
    if (this.#isClosed) return;
    const { token: _token, detail: _detail, ...given } = options, { broker, leave } = shared(where, name, given);
    this.#end = leave;
    const connected = await broker, core = await coreOf(connected.module);
    if (this.#isClosed) return;
    const stream = connected.watch(name, { ...given, profile: { ...profileIn(query), ...given.profile } });
    this.#end = () => {
      stream.close();
      leave();
    };
    stream.on('status', (status) => this.#hooks.status(status));
    stream.on('error', (error) => this.#hooks.error(error));
    stream.on('surface', (surface) => this.#hooks.surface(surface));
    stream.on('image', (image) => this.#hooks.image(image));
    const live = (this.#live = new LiveSurface(stream, core, (drawn) => drawn && live.surface && this.#hooks.drawn(drawn, live.surface)));
    this.#timer = setInterval(() => this.#pause(performance.now() - this.#advancedMs > IDLE_MS), 1000);
  }
  #pause(isPaused: boolean): void {
    const stream = this.stream;
    if (!stream || isPaused === this.#isPaused) return;
    this.#isPaused = isPaused;
    if (isPaused) stream.pause();
    else stream.resume();
  }
}
