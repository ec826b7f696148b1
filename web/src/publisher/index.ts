// SPDX-License-Identifier: MIT
/** `eigencast/publisher`: sends poses of a surface that the broker holds. */
import { compiled, type ConnectOptions } from '../client/client.js';
import { READERS, readControl, writeControl, type Fields } from '../client/control.js';
import { defaults } from '../client/defaults.js';
import { surroundings, type Environment } from '../client/environment.js';
import { Events } from '../client/events.js';
import { failureOfClose, failureOfHandshake } from '../client/refusal.js';
import { Retry, tryAgainIn, type Failure } from '../client/retry.js';
import { endpoint, locatedUrl, type BrokerUrl } from '../client/url.js';
import { AssetReader, type AssetFacts } from '../core/asset.js';
import type { Format } from '../core/frames.js';
import { Core, EigencastError } from '../core/module.js';
import { Writer } from '../core/writer.js';

export interface PublishOptions extends Pick<ConnectOptions, 'token' | 'core' | 'environment'> {
  /** Of an asset that the broker holds: 64 hexadecimal digits, such as `surface.asset` of a stream that is watched. */
  asset: string;
  /** What quantising may change: area-weighted rms, surface units. Default: a thousandth of the diagonal of its box. */
  error?: number;
  /** What rides on each vertex besides its position, at most ten; ranges are those to expect. */
  scalars?: readonly PublishedScalar[];
  /** Announced (default 30); send() may be called at any rate. */
  keyRateHz?: number;
  /** eigencast-writer.wasm, as `core`. Default: beside this file. */
  writer?: ConnectOptions['core'];
}
export interface PublishedScalar {
  /** 1 to 64 of A-Z a-z 0-9 . _ - */
  name: string;
  unit?: string;
  low?: number;
  high?: number;
  /** As for positions; default: a thousandth of the range. */
  error?: number;
}
export interface PublisherStatus {
  state: 'connecting' | 'announcing' | 'live' | 'lost' | 'refused' | 'closed';
  /** For people: what is going on, why, and when the next try starts. */
  detail: string;
  subscribers: number;
}
export interface PublisherEvents {
  /** Something of it changed. */
  status: PublisherStatus;
}

const ANNOUNCE_AGAIN_MS = 5000, CONNECT_TIMEOUT_MS = 3000, PING_MS = 2000, SILENCE_US = 10_000_000;
const MAX_UNSENT_BYTES = 65536;

const SENDERS = {
  ping: READERS.ping, pong: READERS.pong, error: READERS.error, bye: READERS.bye,
  announced: (f: Fields) => ({ op: 'announced' as const, stream_id: f.id('stream_id'), epoch: f.id('epoch'), tag: f.integer('tag', 0, 255), resume: f.text('resume', '') }),
  subscribers: (f: Fields) => ({ op: 'subscribers' as const, count: f.id('count') }),
};

/** Publishes one stream, and keeps doing so: announces, sends, reconnects. Poses meanwhile are dropped. */
export class Publisher extends Events<PublisherEvents> {
  readonly facts: AssetFacts;
  /** rank x (3 + scalars), row-major: the coefficients of the rest pose, where scalars are 0. */
  readonly rest: Float64Array;
  /** What holds now; listen to `status` for more. */
  status: PublisherStatus = { state: 'connecting', detail: 'connecting', subscribers: 0 };
  sent = 0;
  dropped = 0;
  readonly #environment: Environment;
  readonly #broker: BrokerUrl;
  readonly #stream: string;
  readonly #announce: object;
  readonly #writer: Writer;
  /** What channels are multiplied with: 1 for positions. */
  readonly #scales: readonly number[];
  readonly #retry = new Retry();
  #socket: WebSocket | undefined;
  #openedUs: number | undefined;
  #lastHeardUs = 0;
  #holdOffMs: number | undefined;
  #resume = '';
  #lastUs = -1n;
  #timer: ReturnType<typeof setTimeout> | undefined;
  #ticker: ReturnType<typeof setInterval> | undefined;

  /** Use publish(). */
  constructor(environment: Environment, broker: BrokerUrl, stream: string, facts: AssetFacts, rest: Float64Array, writer: Writer, scales: readonly number[], announce: object) {
    super();
    [this.#environment, this.#broker, this.#stream, this.facts, this.rest, this.#writer, this.#scales, this.#announce] = [environment, broker, stream, facts, rest, writer, scales, announce];
    this.#connect();
  }

  /**
   * coefficients  rank x (3 + scalars), row-major
   * captureUs     when the pose holds: any clock that grows (default: now)
   * False: it was dropped, for want of a connection or of room in it, or as it is not after the one before. Throws
   * EigencastError (invalid-argument, too-large) for what no pose can be.
   */
  send(coefficients: ArrayLike<number>, captureUs: bigint | number = this.#environment.nowUs()): boolean {
    const socket = this.#socket, us = BigInt(captureUs);
    if (coefficients.length !== this.rest.length) throw new EigencastError('invalid-argument', `a pose has ${this.rest.length} coefficients, not ${coefficients.length}`);
    if (!socket || this.status.state !== 'live' || socket.bufferedAmount > MAX_UNSENT_BYTES || us <= this.#lastUs) return (++this.dropped, false);
    const scales = this.#scales, scaled = scales.length === 3 ? coefficients : Float64Array.from(coefficients, (value, i) => value * scales[i % scales.length]!);
    socket.send(this.#writer.frame(scaled, us) as Uint8Array<ArrayBuffer>);
    this.#lastUs = us;
    ++this.sent;
    return true;
  }
  close(): void {
    if (this.status.state === 'closed') return;
    this.#tell('closed', 'closed');
    this.#letGo()?.close(1000);
    clearTimeout(this.#timer);
    this.#writer.free();
  }

  get #where(): string {
    return `${this.#broker.base.replace(/^http/, 'ws')}/${this.#stream}`;
  }
  #tell(state: PublisherStatus['state'], detail: string, subscribers = state === 'live' ? this.status.subscribers : 0): void {
    this.status = { state, detail, subscribers };
    this.emit('status', this.status);
  }
  #letGo(): WebSocket | undefined {
    const socket = this.#socket;
    this.#socket = undefined;
    clearInterval(this.#ticker);
    clearTimeout(this.#timer);
    return socket;
  }

  #connect(): void {
    const path = `/v1/publish/${this.#stream}`;
    let socket: WebSocket;
    try {
      socket = new this.#environment.WebSocket(endpoint(this.#broker, path, '', 'ws'), 'eigencast.v2');
    } catch (error) {
      return this.#over({ code: 'refused', message: `no WebSocket at ${this.#where}: ${(error as Error).message}`, refused: true });
    }
    this.#socket = socket;
    this.#openedUs = undefined;
    const isCurrent = (): boolean => this.#socket === socket;
    this.#timer = setTimeout(() => isCurrent() && this.#over({ code: 'timeout', message: `${this.#where} does not answer` }), CONNECT_TIMEOUT_MS);
    socket.onopen = () => {
      if (!isCurrent()) return socket.close();
      clearTimeout(this.#timer);
      this.#openedUs = this.#lastHeardUs = this.#environment.nowUs();
      this.#ticker = setInterval(() => this.#onTick(), PING_MS);
      this.#again();
    };
    socket.onmessage = ({ data }: MessageEvent<unknown>) => {
      if (!isCurrent() || typeof data !== 'string') return;
      this.#lastHeardUs = this.#environment.nowUs();
      try {
        this.#onMessage(data);
      } catch (error) {
        console.warn(`eigencast: from the broker: ${(error as Error).message}`);
      }
    };
    socket.onerror = () => {};  // What follows is onclose, which says as much.
    socket.onclose = ({ code, reason }) => {
      if (!isCurrent()) return;
      if (this.#openedUs !== undefined) return this.#over(failureOfClose(this.#where, code, reason));
      const asked = endpoint(this.#broker, path, '', 'http');
      void failureOfHandshake(this.#environment, asked, this.#where, this.#broker.token !== '').then((failure) => isCurrent() && this.#over(failure));
    };
  }
  #again(): void {
    this.#tell('announcing', `announcing ${this.#where}`);
    this.#say('announce', { ...this.#announce, ...(this.#resume === '' ? {} : { resume: this.#resume }) });
  }
  #onMessage(text: string): void {
    const message = readControl(text, SENDERS);
    switch (message?.op) {
      case 'announced':
        this.#writer.begin(message.stream_id, message.tag);
        this.#lastUs = -1n;
        this.#resume = message.resume;
        return this.#tell('live', `live at ${this.#where}`);
      case 'subscribers':
        return this.#tell(this.status.state, this.status.detail, message.count);
      case 'ping':
        return this.#say('pong', { id: message.id, time_us: message.time_us, peer_time_us: this.#environment.nowUs() });
      case 'error':
        this.#tell('refused', `the broker says: ${message.message} (${message.code})${tryAgainIn(ANNOUNCE_AGAIN_MS)}`);
        clearTimeout(this.#timer);
        return void (this.#timer = setTimeout(() => this.#again(), ANNOUNCE_AGAIN_MS));
      case 'bye':
        this.#holdOffMs = message.retry_after_ms;
    }
  }
  #onTick(): void {
    const now = this.#environment.nowUs();
    if (now - this.#lastHeardUs > SILENCE_US) return this.#over({ code: 'timeout', message: `${this.#where} fell silent` });
    this.#say('ping', { id: 1, time_us: now });
  }
  #say(op: string, fields: object): void {
    this.#socket?.send(writeControl(op, fields));
  }
  #over(failure: Failure): void {
    const openForMs = this.#openedUs === undefined ? undefined : (this.#environment.nowUs() - this.#openedUs) / 1000;
    this.#letGo()?.close();
    const waitMs = this.#retry.after(failure, openForMs, this.#holdOffMs, this.#environment.random());
    this.#holdOffMs = undefined;
    if (waitMs > 0) this.#timer = setTimeout(() => this.#connect(), waitMs);
    this.#tell(failure.code === 'refused' || waitMs === 0 ? 'refused' : 'lost', failure.message + tryAgainIn(waitMs));
  }
}

/** A stream by its URL, such as https://host/lab/ball. Throws EigencastError (invalid-argument, not-found, ...). */
export async function publish(url: string, { asset, error, scalars: wanted = [], keyRateHz = 30, token, core, writer, environment: given }: PublishOptions): Promise<Publisher> {
  const environment = surroundings(given), { broker, stream } = await locatedUrl(url, token, environment);
  const load = async (module: (typeof defaults)['core']): Promise<Core> => Core.make(await compiled(module, environment));
  const [reading, writing] = await Promise.all([load(core ?? defaults.core), load(writer ?? defaults.writer)]);
  const answer = await environment.fetch(endpoint(broker, `/v1/assets/${asset}`, '', 'http'));
  if (!answer.ok) throw new EigencastError(answer.status === 404 ? 'not-found' : 'refused', `asset ${asset}: ${broker.base} answered ${answer.status}`);
  const reader = new AssetReader(reading, asset, new Uint8Array(await answer.arrayBuffer()));
  const { facts, rest } = reader;
  reader.free();
  const bound = error ?? Math.hypot(...facts.boxHigh.map((high, i) => high - facts.boxLow[i]!)) / 1000;
  const scalars = wanted.map(({ name, unit = '', low = 0, high = 0, error: own = (high - low) / 1000 }) => ({ name, unit, low, high, scale: own > 0 ? bound / own : 1 }));
  const channels = 3 + scalars.length, rows = facts.rank, band_ends = facts.bandEnds, codec = 'quantised' as const;
  const format: Format = { rows, channels, band_ends, codec, velocity_channels: 0, velocity_us: 1_000_000, scalars };
  const made = new Writer(writing, format, bound, facts.area), announced = { rows, channels, band_ends, codec, ...(scalars.length > 0 ? { scalars } : {}) };
  const begun = Float64Array.from({ length: rows * channels }, (_, i) => (i % channels < 3 ? rest[3 * Math.floor(i / channels) + (i % channels)]! : 0));
  return new Publisher(environment, broker, stream, facts, begun, made, [1, 1, 1, ...scalars.map(({ scale }) => scale)], { asset, format: announced, key_rate_hz: keyRateHz });
}
