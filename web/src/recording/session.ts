// SPDX-License-Identifier: MIT
import { Frames } from '../core/frames.js';
import { EigencastError, type Core } from '../core/module.js';
import { assetOf, formatOf, readControl, utcIn, type Fields, type StreamInfo } from '../client/control.js';
import type { Environment } from '../client/environment.js';
import type { ToPage } from '../client/protocol.js';
import { Session } from '../client/session.js';
import type { Observer, Pose } from '../client/subscription.js';
import { SurfaceSource, type Limits } from '../client/surface_source.js';
import type { RecordingReader } from './reader.js';

/** Poses of a time: with another `seek` than before from there, else on from what was asked for last. */
export interface Read {
  fromUs: number;
  untilUs: number;
  seek: number;
}
/** Of a recording, when there is something to play, when what was sought follows, and when what was asked for has come. */
export type ToPlayer = ToPage | { op: 'opened'; stream: string; startedMs: number; durationUs: number } | ({ op: 'sought' } & Read) | ({ op: 'read' } & Read);

const BROKER = { base: 'http://recording', token: '' };
const COUNTS = { keys: 0, synthetic: 0, joins: 0, rejected: 0, missed: 0 };
/** A capture time counts from an earlier one where both lie as far apart as their arrivals, but for so much: sdk/recorded_clip.cpp. */
const JITTER_US = 1_000_000;

type Announce = Required<Pick<StreamInfo, 'asset' | 'format' | 'key_rate_hz' | 'utc_us'>> & { world?: number[]; op: 'announce' };
const READERS = {
  announce: (f: Fields): Announce => {
    return {
      op: 'announce', asset: assetOf(f), format: formatOf(f.object('format')), key_rate_hz: f.number('key_rate_hz', 0, 10_000, 0), utc_us: utcIn(f),
      ...(f.has('world') ? { world: f.array('world', 16, 16).map(Number) } : {}),
    };
  },
};

/** A recording's stream in place of a broker's: its surface, and the poses of the time that is asked for. */
export class RecordedStream {
  readonly surfaces: SurfaceSource;
  readonly #reader: RecordingReader;
  readonly #observer: Observer;
  readonly #frames: Frames;
  #info: StreamInfo | undefined;
  #announced = -1;
  /** As announced. */
  #utcUs = 0n;
  #surfaceCame = (): void => {};
  #asked = 0;
  #seek: number | undefined;
  #queue: Promise<void> = Promise.resolve();
  /** Poses from here until there are read; the next record. */
  #fromUs = 0;
  #untilUs = -1;
  #at = 0;
  #last: { sequence: bigint; captureUs: bigint } | undefined;
  #anchor: { captureUs: number; timeUs: number } | undefined;

  constructor(core: Core, environment: Environment, reader: RecordingReader, limits: Limits, observer: Observer) {
    this.#reader = reader;
    this.#observer = observer;
    this.#frames = new Frames(core);
    const fetch = async (url: string): Promise<Response> => {
      const bytes = await reader.object(url.slice(-64));
      return new Response(bytes as BodyInit | undefined ?? null, { status: bytes ? 200 : 404 });
    };
    this.surfaces = new SurfaceSource(core, { ...environment, fetch }, BROKER, limits, () => this.#onSurface());
  }
  change(): void {}
  pause(): void {}
  end(): void {
    ++this.#asked;
    this.surfaces.end();
    void this.#queue.then(() => this.#frames.free());
  }
  /** Poses from the last checkpoint at or before a time on. Newer asking ends older. */
  read({ fromUs, untilUs, seek }: Read, say: (what: 'sought' | 'read') => void): Promise<void> {
    const mine = ++this.#asked;
    return (this.#queue = this.#queue.then(async () => {
      if (mine !== this.#asked) return;
      if (seek !== this.#seek || fromUs < this.#fromUs || fromUs > this.#untilUs) {
        await this.#goTo(fromUs);
        this.#seek = seek;
        say('sought');
      }
      while (mine === this.#asked && this.#untilUs < untilUs) if (!(await this.#step(fromUs))) break;
      if (mine === this.#asked) say('read');
    }).catch((error: unknown) => {
      this.#untilUs = -1;
      this.#tell('refused', (error as Error).message);
    }));
  }

  async #goTo(timeUs: number): Promise<void> {
    const entry = this.#reader.entryAt(timeUs);
    this.#untilUs = -1;
    this.#anchor = this.#last = undefined;
    this.#frames.restart();
    if (entry.announce !== this.#announced) await this.#announce(entry.announce);
    [this.#at, this.#fromUs, this.#untilUs] = [entry.checkpoint, entry.timeUs, entry.timeUs];
  }
  /** False: the recording ends, or its surface changes behind fromUs. */
  async #step(fromUs: number): Promise<boolean> {
    const record = await this.#reader.at(this.#at);
    if (!record || record.type === 'end') {
      this.#untilUs = Infinity;
      return false;
    }
    if (record.type === 'announce') {
      const before = this.#info, next = readControl(new TextDecoder().decode(record.body), READERS);
      if (next && before && !isSame(before, next) && record.timeUs > fromUs) return false;
      await this.#announce(this.#at);
      this.#anchor = this.#last = undefined;
    }
    if (record.type === 'frame' || record.type === 'checkpoint') this.#decode(record.body, record.timeUs);
    this.#at = record.end;
    this.#untilUs = Math.max(this.#untilUs, record.timeUs);
    return true;
  }
  /** With the memory that keys behind it need. */
  async #announce(offset: number): Promise<void> {
    const record = await this.#reader.at(offset), text = record?.type === 'announce' ? new TextDecoder().decode(record.body) : '';
    const { op, ...announce } = readControl(text, READERS) ?? refuse('the recorded announcement is none');
    this.#utcUs = announce.utc_us;
    const following = await this.#reader.at(record!.end), before = this.#info, profile = { rate: 'raw', k: 3, scheme: 'linear', bands: 8 } as const;
    if (!before || !isSame(before, announce)) {
      const info = (this.#info = { stream: this.#reader.stream, state: 'live', stream_id: 0, tag: 0, epoch: (before?.epoch ?? 0) + 1, profile, ...announce });
      if (!(await this.#reader.object(info.asset))) refuse('the recording does not hold its surface: record with recording.include_asset = true');
      this.#observer.onInfo(info);
      this.surfaces.announce(info);
      await new Promise<void>((resolve) => {
        this.#surfaceCame = resolve;
        this.#onSurface();
      });
    }
    this.#frames.begin(0, 0, this.#info!.epoch, announce.format, 'linear');
    this.#frames.restart();
    this.#frames.forgetMemory();
    const ids = following?.type === 'memory' ? following.body : new Uint8Array();
    for (let i = 0; i + 32 <= ids.length; i += 32) {
      const segment = await this.#reader.object(Array.from(ids.subarray(i, i + 32), (byte) => byte.toString(16).padStart(2, '0')).join(''));
      this.#frames.remember(announce.asset, segment ?? refuse('the recording does not hold the poses that its keys are predicted from'));
    }
    this.#announced = offset;
  }
  #decode(bytes: Uint8Array, timeUs: number): void {
    const { head, coefficients, shownUs } = this.#frames.decode(bytes), info = this.#info!, reader = this.surfaces.shown?.reader;
    if (!head || !coefficients || !reader || (this.#last?.sequence === head.sequence && this.#last.captureUs === head.captureUs)) return;
    this.#last = { sequence: head.sequence, captureUs: head.captureUs };
    const captureUs = Number(shownUs), smooth = this.#anchor && this.#anchor.timeUs + captureUs - this.#anchor.captureUs;
    const at = smooth !== undefined && Math.abs(smooth - timeUs) < JITTER_US ? smooth : timeUs;
    if (at === timeUs) this.#anchor = { captureUs, timeUs };
    const utc_us = this.#utcUs + shownUs - BigInt(at);  // Capture times are here positions.
    if (info.utc_us !== utc_us) this.#observer.onInfo((this.#info = { ...info, utc_us }));
    const { channels, band_ends } = info.format!, { rank } = reader.facts;
    if (channels < 3 || coefficients.length < rank * channels) return;
    const pose: Pose = {
      kind: 'key', sequence: head.sequence, epoch: info.epoch, captureUs: BigInt(at), arrivalUs: timeUs, bands: head.bands, channels, bandEnds: band_ends.filter((end) => end <= rank),
      coefficients: reader.filled(coefficients.slice(0, rank * channels), channels, head.bands), next: undefined,
    };
    this.#observer.onPose(pose);
  }
  #onSurface(): void {
    const { shown, latest } = this.surfaces;
    if (latest && latest.damage !== '') return this.#tell('refused', latest.damage);
    if (!shown?.reader || shown !== latest) return;
    this.#observer.onSurface({
      epoch: shown.info!.epoch, asset: shown.look, facts: shown.reader.facts, rest: shown.reader.rest, colours: shown.reader.colours, normals: shown.reader.normals, continues: false, isPrefix: shown.isPrefix, isComplete: shown.isFinished,
    });
    const image = shown.isFinished ? shown.reader.image : undefined;
    if (image) this.#observer.onImage(image);
    this.#tell('live', `a recording of ${this.#reader.stream}, ${new Date(this.#reader.startedMs).toISOString().slice(0, 16).replace('T', ' ')} UTC`);
    if (!shown.isPrefix) this.#surfaceCame();
  }
  #tell(state: 'live' | 'refused', detail: string): void {
    this.#observer.onStatus({
      state, detail, sinceMs: Date.now(), counts: COUNTS, bytes: 0, dropped: 0, reconnects: 0, retryInMs: undefined,
      asset: { downloadedBytes: 0, totalBytes: this.surfaces.latest?.totalBytes ?? 0 }, clock: undefined,
    });
  }
}

function isSame(a: Pick<StreamInfo, 'asset' | 'format'>, b: Pick<StreamInfo, 'asset' | 'format'>): boolean {
  return a.asset === b.asset && JSON.stringify(a.format) === JSON.stringify(b.format);
}
function refuse(why: string): never {
  throw new EigencastError('corrupt', why);
}

/** What a worker does for a page that plays a recording. */
export class RecordedSession extends Session {
  readonly #opened: (limits: Limits, observer: Observer) => RecordedStream;

  constructor(core: Core, environment: Environment, reader: RecordingReader, post: (message: ToPage, transfer: Transferable[]) => void) {
    super(core, environment, BROKER, post);
    this.#opened = (limits, observer) => new RecordedStream(core, environment, reader, limits, observer);
  }
  stream: RecordedStream | undefined;
  protected override open(request: Limits, observer: Observer): RecordedStream {
    return (this.stream = this.#opened(request, observer));
  }
}
