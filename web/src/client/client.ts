// SPDX-License-Identifier: MIT
import { Core, EigencastError } from '../core/module.js';
import type { Playing } from '../core/playout.js';
import type { StreamInfo } from './control.js';
import { defaults } from './defaults.js';
import { surroundings, type Environment } from './environment.js';
import { Events } from './events.js';
import type { Profile } from './profile.js';
import type { Rebuild, Rebuilt, ToPage, ToWorker } from './protocol.js';
import { remark } from './refusal.js';
import type { Pose, Status, Surface } from './subscription.js';
import { brokerUrl, checkedName, endpoint, locatedUrl, type BrokerUrl } from './url.js';

export interface ConnectOptions {
  /** Presented to the broker; else that of the URL's access_token. */
  token?: string;
  /** eigencast-core.wasm: its URL, its bytes, or compiled. Default: beside this file. */
  core?: string | URL | BufferSource | WebAssembly.Module;
  /** The worker that does the work, or false: this thread does. Default: worker.js beside this file. */
  worker?: Worker | URL | string | false;
  environment?: Partial<Environment>;
  /** Called at once: what it watches is asked for while the core is on its way. */
  meanwhile?: (broker: Broker) => void;
}
export interface WatchOptions {
  profile?: Profile;
  /** What the surface may take in memory (default: 512 MiB); larger ones are refused. */
  maxBytes?: number;
  /** The first, coarse part of the surface is enough, as for a small picture. */
  isPreview?: boolean;
  /** The id of the surface that it probably has, which is fetched beside the question. */
  expects?: string | undefined;
  /** The group of streams that show the same moment (protocol.md, "moment"). */
  sync?: string | undefined;
  /** How long until a broker that declined the stream is asked again (default: 5,000). */
  declinedRetryMs?: number;
}
/** An announced stream, as GET /v1/streams lists it. */
export interface ListedStream {
  stream: string;
  state: 'waiting' | 'live' | 'stalled';
  asset: string;
  epoch: number;
  keyRateHz: number;
  subscribers: number;
}
export interface StreamEvents {
  /** State or detail changed. */
  status: Status;
  info: StreamInfo;
  /** The surface can be drawn, or has grown. */
  surface: Surface;
  /** Of the surface: a PNG or JPEG, once it is whole. */
  image: Uint8Array;
  pose: Pose;
  /** What cannot be put right by waiting, such as watching a stream twice. */
  error: EigencastError;
}

const MAX_BYTES = 512 * 2 ** 20;

/** A stream that is watched until close(). */
export class Stream extends Events<StreamEvents> {
  /** The last of each that came. */
  status: Status | undefined;
  info: StreamInfo | undefined;
  surface: Surface | undefined;
  image: Uint8Array | undefined;
  pose: Pose | undefined;
  error: EigencastError | undefined;
  /** What plays its poses instead of those who show it. Not for users. */
  playout?: Playing;
  readonly #post: (message: ToWorker, transfer?: Transferable[]) => void;
  readonly #closed: () => void;
  readonly #waiting = new Map<number, { resolve: (answer: never) => void; reject: (error: Error) => void }>();
  #requests = 0;

  constructor(readonly name: string, readonly key: number, post: (message: ToWorker, transfer?: Transferable[]) => void, closed: () => void) {
    super();
    this.#post = post;
    this.#closed = closed;
  }
  /** Asks for another profile. */
  setProfile(profile: Profile): void {
    this.#post({ op: 'profile', key: this.key, profile });
  }
  /** For pages that nobody sees: no poses come, the connection stays, and resume() takes one message. */
  pause(): void {
    this.#post({ op: 'pause', key: this.key, isPaused: true });
  }
  resume(): void {
    this.#post({ op: 'pause', key: this.key, isPaused: false });
  }
  /** Positions, normals and triangles of a pose. Rejects where nothing of the surface has arrived yet. */
  rebuild(rebuild: Rebuild): Promise<Rebuilt> {
    const room = [rebuild.room?.positions, rebuild.room?.normals].filter((buffer) => buffer !== undefined);
    return this.#ask((request) => this.#post({ op: 'rebuild', key: this.key, request, rebuild }, room));
  }
  /** The numbers in the source of drawn vertices; 2^32 - 1: unknown. */
  sources(vertices: Uint32Array, isTextured: boolean): Promise<Uint32Array> {
    return this.#ask((request) => this.#post({ op: 'sources', key: this.key, request, vertices, isTextured }));
  }
  #ask<Answer>(post: (request: number) => void): Promise<Answer> {
    return new Promise((resolve, reject) => {
      this.#waiting.set(++this.#requests, { resolve, reject });
      post(this.#requests);
    });
  }
  close(): void {
    this.#post({ op: 'leave', key: this.key });
    for (const { reject } of this.#waiting.values()) reject(new EigencastError('cancelled', 'the stream was closed'));
    this.#waiting.clear();
    this.#closed();
  }

  /** What its session has to say. Not for users. */
  receive(message: ToPage): void {
    switch (message.op) {
      case 'status':
        return this.emit('status', (this.status = message.status));
      case 'info':
        return this.emit('info', (this.info = message.info));
      case 'surface':
        if (message.surface.asset !== this.surface?.asset) this.image = undefined;
        return this.emit('surface', (this.surface = message.surface));
      case 'image':
        return this.emit('image', (this.image = message.image));
      case 'pose':
        return this.emit('pose', (this.pose = message.pose));
      case 'rebuilt':
      case 'sources':
        this.#waiting.get(message.request)?.resolve((message.op === 'rebuilt' ? message.rebuilt : message.sources) as never);
        return void this.#waiting.delete(message.request);
      case 'failed': {
        const error = new EigencastError(message.code, message.message);
        if (message.request === undefined) return this.emit('error', (this.error = error));
        this.#waiting.get(message.request)?.reject(error);
        this.#waiting.delete(message.request);
      }
    }
  }
}

/** A broker, and one connection to it for all streams that are watched. */
export class Broker {
  readonly #url: BrokerUrl;
  /** The core, compiled: for a Stage. */
  module!: WebAssembly.Module;
  readonly #environment: Environment;
  readonly #post: (message: ToWorker, transfer?: Transferable[]) => void;
  readonly #ended: () => void;
  readonly #streams = new Map<number, Stream>();
  #keys = 0;
  /** Who hears of rooms and moments (protocol.md, "room", "moment"); nothing: the connection is new. */
  readonly onText = new Set<(text: string) => void>();

  private constructor(
    url: BrokerUrl, environment: Environment, post: (message: ToWorker, transfer?: Transferable[]) => void, ended: () => void,
  ) {
    this.#url = url;
    this.#environment = environment;
    this.#post = post;
    this.#ended = ended;
  }

  /** Throws EigencastError (invalid-argument) for a URL that cannot be meant; a broker that is away is tried again. */
  static async make(url: BrokerUrl, options: ConnectOptions): Promise<Broker> {
    const environment = surroundings(options.environment);
    const compiling = compiled(options.core ?? defaults.core, environment);
    if (options.worker === false) {
      const { Session } = await import('./session.js');
      const module = await compiling, core = await Core.make(module);
      const session = new Session(core, environment, url, (message) => broker.#receive(message));
      const broker = new Broker(url, environment, (message) => session.receive(message), () => {});
      broker.module = module;
      options.meanwhile?.(broker);
      return broker;
    }
    // It starts while the core is on its way.
    const given = options.worker ?? defaults.worker;
    const worker = typeof given === 'string' || given instanceof URL ? workerAt(given) : given;
    let failed = '';
    const broker = new Broker(url, environment, (message, transfer = []) => worker.postMessage(message, transfer), () => worker.terminate());
    worker.onmessage = ({ data }: MessageEvent<ToPage>) => broker.#receive(data);
    worker.onerror = (event) => broker.#fail((failed = workerFailure(event)));
    broker.#post({ op: 'begin', broker: url });
    try {
      options.meanwhile?.(broker);
      broker.#post({ op: 'core', module: (broker.module = await compiling) });
    } catch (error) {
      compiling.catch(() => {});
      worker.terminate();
      throw error;
    }
    if (failed !== '') setTimeout(() => broker.#fail(failed));
    return broker;
  }

  watch(stream: string, { profile = {}, maxBytes = MAX_BYTES, isPreview = false, expects, sync, declinedRetryMs }: WatchOptions = {}): Stream {
    const key = ++this.#keys;
    const made = new Stream(checkedName(stream), key, this.#post, () => void this.#streams.delete(key));
    this.#streams.set(key, made);
    // After the caller has put its listeners on.
    queueMicrotask(() => {
      if (this.#streams.has(key)) this.#post({ op: 'watch', key, stream, profile, maxBytes, isPreview, expects, sync, declinedRetryMs });
    });
    return made;
  }
  /** Announced streams that the caller may watch, by name. Throws EigencastError. */
  async streams(): Promise<ListedStream[]> {
    return (await import('./list.js')).listedStreams(this.#url, this.#environment, { endpoint, remark });
  }
  /** A control message of rooms or groups; lost where there is no connection. */
  sendText(text: string): void {
    this.#post({ op: 'room', text });
  }
  /** Connects at once where it waits for its next try. */
  retryNow(): void {
    this.#post({ op: 'retry' });
  }
  /** Ends all its streams. */
  close(): void {
    for (const stream of [...this.#streams.values()]) stream.close();
    this.#post({ op: 'end' });
    this.#ended();
  }

  #receive(message: ToPage): void {
    if (message.op === 'room') return this.onText.forEach((hear) => hear(message.text));
    this.#streams.get(message.key)?.receive(message);
  }
  #fail(message: string): void {
    for (const [key, stream] of this.#streams) stream.receive({ op: 'failed', key, code: 'internal', message });
  }
}

export function workerFailure({ message }: ErrorEvent): string {
  return message ? `the worker failed: ${message}` : 'the worker does not start: its script is missing, or worker-src of the page\'s policy forbids it';
}
/** Browsers start scripts of another origin, such as a CDN's, only by one of the page's own. */
export function workerAt(given: URL | string): Worker {
  const url = new URL(given, globalThis.location?.href);
  if (url.origin === globalThis.location?.origin) return new Worker(url, { type: 'module' });
  const own = URL.createObjectURL(new Blob([`import ${JSON.stringify(url.href)}`], { type: 'text/javascript' }));
  try {
    return new Worker(own, { type: 'module' });
  } finally {
    setTimeout(() => URL.revokeObjectURL(own), 60_000);
  }
}

export async function compiled(given: (typeof defaults)['core'], environment: Environment): Promise<WebAssembly.Module> {
  const core = await given;
  if (core instanceof WebAssembly.Module) return core;
  if (typeof core !== 'string' && !(core instanceof URL)) return WebAssembly.compile(core);
  const answer = await environment.fetch(String(core));
  if (!answer.ok) throw new EigencastError('not-found', `${core} answered ${answer.status}`);
  if (answer.headers.get('Content-Type') === 'application/wasm') return WebAssembly.compileStreaming(answer);
  return WebAssembly.compile(await answer.arrayBuffer());
}

/** A broker by its URL: https://HOST[:PORT][/PREFIX], or http, wss, ws; HOST alone means port 7490. */
export function connect(url: string, options: ConnectOptions = {}): Promise<Broker> {
  return Broker.make(brokerUrl(url, options.token), options);
}

/** One stream by its URL, such as https://host/lab/horse?rate=raw, over a connection of its own, which ends with it. */
export async function watch(url: string, options: ConnectOptions & WatchOptions = {}): Promise<Stream> {
  const { broker: where, stream, query } = await locatedUrl(url, options.token, surroundings(options.environment));
  let watched!: Stream;
  const profile = { ...(await import('./query.js')).profileIn(query), ...options.profile };
  const broker = await Broker.make(where, { ...options, meanwhile: (made) => (watched = made.watch(stream, { ...options, profile })) });
  const close = watched.close.bind(watched);
  watched.close = () => {
    close();
    broker.close();
  };
  return watched;
}
