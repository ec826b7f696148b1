// SPDX-License-Identifier: MIT
import type { AssetFacts } from '../core/asset.js';
import { Frames, type Counts, type FrameHead, type KINDS, type Next } from '../core/frames.js';
import type { Core } from '../core/module.js';
import type { ClockEstimate } from './clock_offset.js';
import type { BrokerConnection, Listener, Request } from './connection.js';
import type { Remember, StreamInfo } from './control.js';
import type { Environment } from './environment.js';
import type { MemoryFetcher } from './memory.js';
import { ObjectFetcher } from './objects.js';
import type { Profile } from './profile.js';
import { tryAgainIn, type Failure } from './retry.js';
import { SurfaceSource, type Limits } from './surface_source.js';
import type { BrokerUrl } from './url.js';

/** What there is to see of a stream, in the words of the native client. */
export type State = 'connecting' | 'waiting' | 'downloading' | 'live' | 'stalled' | 'lost' | 'refused';

export interface Status {
  state: State;
  /** For people: what is going on, why, and when the next try starts. */
  detail: string;
  /** Of the page's clock (Date.now()): when this state began. */
  sinceMs: number;
  /** Until the next try to connect, or to ask again for a stream that was declined; nothing: there is none. */
  retryInMs: number | undefined;
  counts: Counts;
  /** Frames, envelopes included. */
  bytes: number;
  /** Frames that newer ones overtook in the broker. */
  dropped: number;
  reconnects: number;
  asset: { downloadedBytes: number; totalBytes: number };
  clock: ClockEstimate | undefined;
}
export interface Pose {
  /** A key that is sent ahead shows a step. */
  kind: (typeof KINDS)[number];
  sequence: bigint;
  epoch: number;
  /** On the sender's clock. */
  captureUs: bigint;
  /** On the client's. */
  arrivalUs: number;
  bands: number;
  channels: number;
  bandEnds: number[];
  /** rank x channels, row-major; bands that did not come are those of the rest pose. */
  coefficients: Float64Array;
  /** A key whose poses are still to come, once for each. */
  next: Next | undefined;
}
export interface Surface {
  epoch: number;
  asset: string;
  facts: AssetFacts;
  rest: Float64Array;
  /** Three a vertex that has arrived, sRGB; nothing: it has none. */
  colours: Uint8Array | undefined;
  /** One a vertex that has arrived, of its file: 0 none, 1 the same at all its corners, 2 several, so that its edges are hard; nothing: it has none. */
  normals: Uint8Array | undefined;
  /** Poses go on from those of the epoch before. */
  continues: boolean;
  /** Only the lowest band of the first vertices, for a first picture. */
  isPrefix: boolean;
  isComplete: boolean;
}
/** Who hears of a subscription. */
export interface Observer {
  onStatus(status: Status): void;
  onInfo(info: StreamInfo): void;
  /** It can be drawn, or has grown. */
  onSurface(surface: Surface): void;
  /** Of the last surface: a PNG or JPEG, once it is whole. */
  onImage(image: Uint8Array): void;
  onPose(pose: Pose): void;
}

const NOTICE_US = 3_000_000, FIGURES_US = 500_000;

/** Watches one stream: sdk/subscriber.h. */
export class Subscription implements Listener {
  readonly #environment: Environment;
  readonly #newMemory: (asset: string, over: AbortSignal) => Promise<MemoryFetcher>;
  readonly #newFetcher: () => ObjectFetcher;
  readonly #connection: BrokerConnection;
  readonly #where: string;
  readonly #stream: string;
  readonly #observer: Observer;
  readonly #frames: Frames;
  readonly surfaces: SurfaceSource;
  #info: StreamInfo | undefined;
  #memory: Promise<MemoryFetcher> | undefined;
  #memoryOver = new AbortController();
  #held: Pose | undefined;
  #isOpen = false;
  #everOpen = false;
  #isRefused = false;
  #isDeclined = false;
  #trouble = '';
  #notice = '';
  #noticeUntilUs = 0;
  #retryAtUs: number | undefined;
  #bytes = 0;
  #dropped = 0;
  #reconnects = 0;
  #clock: ClockEstimate | undefined;
  #told = '';
  #toldUs = 0;
  #imageOf: unknown;
  #state: State = 'connecting';
  #sinceMs = Date.now();

  constructor(core: Core, environment: Environment, broker: BrokerUrl, connection: BrokerConnection, request: Request & Limits, observer: Observer) {
    this.#environment = environment;
    this.#connection = connection;
    this.#where = `${broker.base.replace(/^http/, 'ws')}/${request.stream}`;
    this.#stream = request.stream;
    this.#observer = observer;
    this.#frames = new Frames(core);
    this.#newFetcher = () => new ObjectFetcher(environment, broker);
    // Loaded where a stream has a memory.
    this.#newMemory = async (asset, over) => new (await import('./memory.js')).MemoryFetcher(core, this.#newFetcher, this.#frames, asset, over, (held) => connection.hold(this, held));
    this.#trouble = `connecting to ${broker.base.replace(/^http/, 'ws')}`;
    this.surfaces = new SurfaceSource(core, environment, broker, request, () => this.#onSurface());
    try {
      connection.join(request, this);
    } catch (error) {
      this.#frames.free();
      this.surfaces.end();
      throw error;
    }
    this.#tell();
  }
  change(profile: Profile): void {
    this.#connection.change(this, profile);
  }
  pause(isPaused: boolean): void {
    this.#connection.pause(this, isPaused);
  }
  end(): void {
    this.#connection.leave(this);
    this.surfaces.end();
    this.#forgetMemory();
    this.#frames.free();
  }

  get status(): Status {
    const [state, detail] = this.#stateAndDetail();
    const latest = this.surfaces.latest;
    return {
      state, detail, sinceMs: this.#sinceMs, counts: this.#frames.counts, bytes: this.#bytes, dropped: this.#dropped, reconnects: this.#reconnects,
      retryInMs: this.#retryAtUs === undefined ? undefined : Math.max(0, (this.#retryAtUs - this.#environment.nowUs()) / 1000),
      asset: { downloadedBytes: latest?.fetcher.downloadedBytes ?? 0, totalBytes: latest?.totalBytes ?? 0 }, clock: this.#clock,
    };
  }

  onOpen(): void {
    if (this.#everOpen) ++this.#reconnects;
    this.#isOpen = this.#everOpen = true;
    this.#isRefused = this.#isDeclined = false;
    this.#trouble = '';
    this.#retryAtUs = undefined;
    this.#clock = undefined;
    this.#frames.restart();
    this.#forgetMemory();
    this.#tell();
  }
  onDown(why: Failure, waitMs: number): void {
    this.#isOpen = this.#isDeclined = false;
    this.#isRefused = why.code === 'refused' || waitMs === 0;
    this.#trouble = why.message + tryAgainIn(waitMs);
    this.#retryAtUs = this.#at(waitMs);
    this.#tell();
  }
  onInfo(info: StreamInfo): void {
    this.#frames.begin(info.stream_id, info.tag, info.epoch, info.format, info.profile.scheme);
    if (this.#info?.epoch !== info.epoch) this.#forgetMemory();
    this.#info = info;
    this.#isDeclined = false;
    this.#retryAtUs = undefined;
    this.#notice = '';
    this.#observer.onInfo(info);
    if (this.surfaces.announce(info)) this.#held = undefined;
    const { asset } = info.next ?? {};
    if (asset) void import('./learnt.js').then(({ prepare }) => prepare(this.surfaces, asset, this.#newFetcher(), () => this.#connection.say('prepared', { stream: info.stream, asset })));
    this.#tell();
  }
  onMemory(memory: Remember): void {
    const asset = this.#info?.asset;
    if (asset === undefined) return;
    this.#memory ??= this.#newMemory(asset, this.#memoryOver.signal);
    this.#memory.then((fetcher) => fetcher.remember(memory)).catch((error: Error) => console.warn(`eigencast: the stream's memory is not used: ${error.message}`));
  }
  onError(message: string, askAgainInMs: number | undefined): void {
    if (askAgainInMs !== undefined) {
      this.#info = undefined;
      this.#isDeclined = true;
      this.#retryAtUs = this.#at(askAgainInMs);
    }
    this.#notice = message;
    this.#noticeUntilUs = Infinity;
    this.#tell();
  }
  onNotice(message: string, framesDropped: number): void {
    this.#dropped += framesDropped;
    this.#notice = message;
    this.#noticeUntilUs = this.#environment.nowUs() + NOTICE_US;
    this.#tell();
  }
  onClock(clock: ClockEstimate): void {
    this.#clock = clock;
    const now = this.#environment.nowUs();
    if (this.#notice !== '' && now > this.#noticeUntilUs) this.#notice = '';
    this.#tell(now - this.#toldUs >= FIGURES_US);
  }
  onFrame(bytes: Uint8Array, nowUs: number): FrameHead | undefined {
    this.#bytes += bytes.length;
    const { head, coefficients, shownUs, next, error } = this.#frames.decode(bytes);
    if (error) console.warn(`eigencast: frame not decoded: ${error.message}`);
    const format = this.#info?.format;
    if (!head || !coefficients || !format) return head;
    const pose: Pose = {
      kind: head.ahead ? 'step' : head.kind, sequence: head.sequence, epoch: head.epoch, captureUs: shownUs, arrivalUs: nowUs, bands: head.bands,
      channels: format.channels, bandEnds: format.band_ends, coefficients: coefficients.slice(), next: next && { ...next, coefficients: next.coefficients.slice() },
    };
    if (this.surfaces.isShown(pose.epoch)) this.#deliver(pose);
    else if (this.surfaces.isPending(pose.epoch)) this.#held = pose;
    return head;
  }

  #forgetMemory(): void {
    this.#memoryOver.abort();
    this.#memoryOver = new AbortController();
    this.#memory = undefined;
    this.#frames.forgetMemory();
    this.#connection.hold(this, 0);
  }
  #at(waitMs: number): number | undefined {
    return waitMs > 0 ? this.#environment.nowUs() + 1000 * waitMs : undefined;
  }
  #onSurface(): void {
    const shown = this.surfaces.shown;
    if (shown?.reader) {
      this.#observer.onSurface({
        epoch: shown.info!.epoch, asset: shown.look, facts: shown.reader.facts, rest: shown.reader.rest, colours: shown.reader.colours, normals: shown.reader.normals, continues: shown.continues, isPrefix: shown.isPrefix, isComplete: shown.isFinished,
      });
    }
    if (shown?.isFinished && this.#imageOf !== shown) {
      this.#imageOf = shown;
      const image = shown.reader?.image;
      if (image) this.#observer.onImage(image);
    }
    const held = this.#held;
    if (held && this.surfaces.isShown(held.epoch)) {
      this.#held = undefined;
      this.#deliver(held);
    }
    this.#tell();
  }
  /** Rows that did not come become those of the rest pose. */
  #deliver(pose: Pose): void {
    const reader = this.surfaces.shown?.reader;
    const rank = reader?.facts.rank ?? 0, size = rank * pose.channels;
    if (!reader || pose.channels < 3 || pose.coefficients.length < size) return;
    // Without its columns the band that the stream has learnt is left out.
    const filled = <One extends { coefficients: Float64Array; bands: number }>(one: One): One =>
      ({ ...one, coefficients: reader.filled(one.coefficients.subarray(0, size), pose.channels, one.bands) });
    this.#observer.onPose({ ...filled(pose), bandEnds: pose.bandEnds.filter((end) => end <= rank), next: pose.next && filled(pose.next) });
  }
  /** The observer hears of states and details that are new; `always`: of figures alone, too. */
  #tell(always = false): void {
    const [state, detail] = this.#stateAndDetail();
    if (state !== this.#state) {
      this.#state = state;
      this.#sinceMs = Date.now();
    }
    if (!always && this.#told === `${state}\n${detail}`) return;
    this.#told = `${state}\n${detail}`;
    this.#toldUs = this.#environment.nowUs();
    this.#observer.onStatus(this.status);
  }
  #stateAndDetail(): [State, string] {
    const { latest, shown, pending } = this.surfaces;
    const late = latest?.fetcher.trouble ?? '';
    if (this.#isRefused) return ['refused', this.#trouble];
    if (!this.#isOpen) return [this.#everOpen ? 'lost' : 'connecting', this.#trouble];
    if (this.#isDeclined) return ['refused', this.#notice];
    if (!this.#info) return ['connecting', this.#notice === '' ? `connected, asking for ${this.#stream}` : this.#notice];
    if (latest && latest.damage !== '') return ['refused', latest.damage];
    if (this.#info.state === 'waiting') return ['waiting', `waiting for a sender at ${this.#where}`];
    if (this.#info.state === 'stalled') return ['stalled', `stalled: the sender of ${this.#where} is gone, its last pose is held`];
    if (pending || !shown) return ['downloading', late === '' ? 'downloading the surface' : late];
    if (!shown.isFinished) return ['live', late === '' ? 'live, downloading detail' : `live, detail is late: ${late}`];
    return ['live', this.#notice === '' ? 'live' : this.#notice];
  }
}
