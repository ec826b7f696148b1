// SPDX-License-Identifier: MIT
import { AssetReader } from '../core/asset.js';
import type { Core } from '../core/module.js';
import type { StreamInfo } from './control.js';
import type { Environment } from './environment.js';
import { ObjectFetcher } from './objects.js';
import type { BrokerUrl } from './url.js';

const MAX_MANIFEST_BYTES = 16 << 20;
/** How often, and for how long at most, a first picture's surface is rebuilt before detail takes the core: for its box, and for its pose. */
const FIRST_REBUILDS = 2, FIRST_MS = 300;

/** What of a surface is wanted. */
export interface Limits {
  /** More is refused. */
  maxBytes: number;
  /** Its first, coarse part is enough, as for a small picture. */
  isPreview?: boolean | undefined;
  /** The surface that will probably be announced: it is fetched meanwhile. */
  expects?: string | undefined;
}

/** One asset on its way: first from a prefix of its first chunk, with the lowest band alone, then whole, chunk by chunk. */
export class Arriving {
  /** The fullest that can be drawn. */
  reader: AssetReader | undefined;
  totalBytes = 0;
  /** Why it can never be drawn; empty while it may. */
  damage = '';
  readonly fetcher: ObjectFetcher;

  /** Of what is the same to who sees it, but for columns that its stream has learnt. */
  look: string;
  /** Columns before its stream learnt more: poses of then are drawn, too. */
  before = 0;
  /** Its poses go on from those of the epoch before. */
  continues = false;

  constructor(readonly asset: string, public info: StreamInfo | undefined, environment: Environment, broker: BrokerUrl, readonly isPreview = false, private after?: Arriving, private readonly ready?: (arriving: Arriving) => void) {
    this.look = asset;
    this.fetcher = new ObjectFetcher(environment, broker);
  }
  get isFinished(): boolean {
    return this.reader !== undefined && this.reader.isComplete && !this.isPrefix;
  }
  isPrefix = false;
  #rebuilds = 0;
  #seen = (): void => {};
  /** Says that it was rebuilt. */
  rebuilt(): void {
    if (++this.#rebuilds === FIRST_REBUILDS) this.#seen();
  }
  goesOnAs(asset: string): boolean {
    return this.asset === asset && this.damage === '';
  }

  /** Until it is whole, damaged or stopped; `grown` after each step. */
  async run(core: Core, maxBytes: number, grown: () => void): Promise<void> {
    let whole: AssetReader | undefined;
    this.fetcher.onTrouble = grown;
    try {
      if (this.ready) return this.ready(this), grown();
      const manifest = await this.fetcher.get({ id: this.asset, maxBytes: MAX_MANIFEST_BYTES }, (bytes) => core.sha256(bytes) === this.asset);
      if (!manifest || this.fetcher.isStopped) return;
      if (this.isPreview) return void (await this.#showPrefix(core, manifest, maxBytes, grown));
      whole = new AssetReader(core, this.asset, manifest, { maxBytes });
      const { after } = this;
      this.after = undefined;
      const learnt = whole.facts.hasColumns && (await import('./learnt.js'));
      if (after && learnt && (await learnt.takeOver(this, after, whole, manifest))) return grown();
      this.totalBytes = manifest.length;
      for (let i = 0; i < whole.chunkCount; ++i) this.totalBytes += whole.chunk(i).bytes;
      this.checkFormat(whole.facts.rank);
      const prefix = await this.#showPrefix(core, manifest, maxBytes, grown);
      const seen = prefix && new Promise<void>((resolve) => setTimeout((this.#seen = resolve), FIRST_MS));
      while (!whole.isComplete && this.damage === '') {
        const { id, bytes } = whole.chunk(whole.next);
        const chunk = await this.fetcher.get({ id, maxBytes: bytes }, (got) => core.sha256(got) === id, whole.next === 0 ? prefix : undefined);
        await seen;
        const columns = learnt && whole.next + 1 === whole.chunkCount && (await learnt.Columns.fetched(this, manifest));
        if (!chunk || this.fetcher.isStopped) return;
        whole.add(chunk);
        if (columns) columns.read(whole)();
        if (this.reader !== whole) this.#show(whole, false);
        grown();
      }
    } catch (error) {
      const why = error instanceof WebAssembly.RuntimeError ? 'memory ran out; reload the page' : (error as Error).message;
      this.damage = `the stream's surface cannot be shown: ${why}`;
      this.fetcher.stop();
      grown();
    } finally {
      if (whole !== this.reader) whole?.free();
    }
  }

  /** Returns the first bytes of the first chunk, where they are a good part of it. */
  async #showPrefix(core: Core, manifest: Uint8Array, maxBytes: number, grown: () => void): Promise<Uint8Array | undefined> {
    const lowest = new AssetReader(core, this.asset, manifest, { bands: 1, maxBytes });
    try {
      const { id, bytes, neededBytes } = lowest.chunk(0);
      if (!this.isPreview && 4 * neededBytes > 3 * bytes) return undefined;
      this.checkFormat(lowest.facts.rank);
      const good = (got: Uint8Array): boolean => {
        if (got.length !== neededBytes) return false;
        lowest.add(got);
        return true;
      };
      const prefix = await this.fetcher.get({ id, maxBytes: bytes, firstBytes: neededBytes }, good);
      if (!prefix || this.fetcher.isStopped) return undefined;
      this.#show(lowest, true);
      grown();
      return prefix;
    } finally {
      if (this.reader !== lowest) lowest.free();
    }
  }
  #show(reader: AssetReader, isPrefix: boolean): void {
    const before = this.reader;
    this.reader = reader;
    this.isPrefix = isPrefix;
    before?.free();
  }
  /** The announced poses may not deform this surface. */
  checkFormat(rank: number): void {
    const format = this.info?.format;
    const why = format === undefined ? '' : !format.band_ends.includes(rank) ? `its basis has ${rank} columns, the stream's poses have ${format.rows}`
      : format.channels < 3 ? 'its poses have fewer than three channels' : '';
    if (why === '') return;
    this.damage = `the stream's surface cannot be shown: ${why}`;
    this.fetcher.stop();
  }
  end(): void {
    this.fetcher.stop();
    this.reader?.free();
    this.reader = undefined;
  }
}

/** The surface that a viewer shows, and the one of a newer epoch that replaces it once it can be drawn: sdk/surfaces.h. */
export class SurfaceSource {
  readonly core: Core;
  readonly #environment: Environment;
  readonly #broker: BrokerUrl;
  readonly #limits: Limits;
  readonly #changed: () => void;
  shown: Arriving | undefined;
  pending: Arriving | undefined;
  /** What is to come next: client/learnt.ts. */
  next: { asset: string; fetcher: ObjectFetcher; take?: (arriving: Arriving) => void } | undefined;

  constructor(core: Core, environment: Environment, broker: BrokerUrl, limits: Limits, changed: () => void) {
    this.core = core;
    this.#environment = environment;
    this.#broker = broker;
    this.#limits = limits;
    this.#changed = changed;
    if (limits.expects !== undefined) this.#begin(limits.expects);
  }

  get maxBytes(): number {
    return this.#limits.maxBytes;
  }
  get latest(): Arriving | undefined {
    return this.pending ?? this.shown;
  }
  /** True: another surface than before is on its way from now on. */
  announce(info: StreamInfo): boolean {
    if (info.state === 'waiting' || info.asset === undefined) return false;
    const adopt = (arriving: Arriving): void => {
      const isOther = arriving.info?.epoch !== info.epoch;
      if (isOther) arriving.continues = false;
      arriving.info = info;
      if (!arriving.reader) return;
      arriving.checkFormat(arriving.reader.facts.rank);
      if (isOther) this.#grown(arriving);  // Poses of the new epoch are this surface's, too.
    };
    if (this.latest?.goesOnAs(info.asset)) {
      adopt(this.latest);
      return false;
    }
    this.pending?.end();
    this.pending = undefined;
    if (this.shown?.goesOnAs(info.asset)) {
      adopt(this.shown);
      return true;
    }
    this.#begin(info.asset, info);
    return true;
  }
  isShown(epoch: number): boolean {
    return this.shown?.reader !== undefined && this.shown.info?.epoch === epoch;
  }
  isPending(epoch: number): boolean {
    return this.pending?.info?.epoch === epoch;
  }
  end(): void {
    this.pending?.end();
    this.shown?.end();
    this.next?.fetcher.stop();
    this.pending = this.shown = this.next = undefined;
  }

  #begin(asset: string, info?: StreamInfo): void {
    const { next } = this;
    next?.fetcher.stop();
    this.next = undefined;
    const arriving = (this.pending = new Arriving(asset, info, this.#environment, this.#broker, this.#limits.isPreview, this.shown, next?.asset === asset ? next.take : undefined));
    void arriving.run(this.core, this.#limits.maxBytes, () => this.#grown(arriving));
  }
  #grown(arriving: Arriving): void {
    if (arriving === this.pending && arriving.reader && arriving.info) {
      this.shown?.end();
      this.shown = arriving;
      this.pending = undefined;
    }
    if (arriving === this.shown || arriving === this.pending) this.#changed();
  }
}
