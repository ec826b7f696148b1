// SPDX-License-Identifier: MIT
import wasm from 'inline:eigencast-columns.wasm';
import type { AssetReader } from '../core/asset.js';
import { inflated } from '../core/base64.js';
import { Core, hexFrom } from '../core/module.js';
import type { ObjectFetcher } from './objects.js';
import type { Arriving, SurfaceSource } from './surface_source.js';

// Columns that a stream has learnt, behind those of its asset: docs/asset-format.md. Loaded where a stream has them.

/** What eigencast-columns.wasm exports, beside what it has of a Core's: web/core/core.h. */
interface Exports {
  columns_open(manifest: number, size: number): number;
  columns_section(columns: number): number;
  columns_read(columns: number, section: number, size: number, map: number): number;
}
const MAX_MANIFEST_BYTES = 16 << 20;

let compiling: Promise<WebAssembly.Module> | undefined;

/** They came, and are not read yet. An instance for each, whose memory goes with it. */
export class Columns {
  readonly #core: Core;
  readonly #exports: Exports;
  readonly #at: number;

  private constructor(core: Core, readonly manifest: Uint8Array) {
    this.#core = core;
    this.#exports = core.exports as unknown as Exports;
    this.#at = core.found(this.#exports.columns_open(core.given(manifest), manifest.length));
  }
  /** Nothing: it was stopped. Throws EigencastError (not-found: the manifest lists none). */
  static async fetched(arriving: Pick<Arriving, 'fetcher' | 'totalBytes'>, manifest: Uint8Array): Promise<Columns | undefined> {
    const core = await Core.make(await (compiling ??= inflated(wasm).then((bytes) => WebAssembly.compile(bytes))));
    const columns = new Columns(core, manifest), section = columns.#exports.columns_section(columns.#at);
    const id = hexFrom(core.bytes(section, 32)), [maxBytes = 0] = core.words(section + 32, 1);
    arriving.totalBytes += maxBytes;
    columns.#section = await arriving.fetcher.get({ id, maxBytes }, (bytes) => core.sha256(bytes) === id);
    return arriving.fetcher.isStopped ? undefined : columns;
  }
  #section: Uint8Array | undefined;
  /** Of the asset, which has all its chunks. Returns what makes it one with these columns, at once. */
  read(asset: AssetReader): () => void {
    const core = this.#core, section = this.#section!, map = asset.map, at = core.room(4 * map.length + section.length);
    core.words(at, map.length).set(map);
    core.bytes(at + 4 * map.length, section.length).set(section);
    const learnt = core.found(this.#exports.columns_read(this.#at, at + 4 * map.length, section.length, at));
    const [scales = 0, values = 0, count = 0] = core.words(learnt, 3), rows = map.length;
    return () => {
      const to = asset.core, [integers = 0, columnScales = 0, columns = 0] = to.words(to.exports.asset_widen(asset.at, count), 3), first = columns - count;
      to.floats(columnScales + 4 * first, count).set(core.floats(scales, count));
      const all = new Int16Array(to.exports.memory.buffer, integers, rows * columns), read = new Int16Array(core.exports.memory.buffer, values, rows * count);
      for (let row = 0; row < rows; ++row) all.set(read.subarray(row * count, (row + 1) * count), row * columns + first);
    };
  }
}

/** Whether `whole`, made of a manifest, has the chunks of the surface that is shown, all of which are there, and nothing else but them and columns. */
function isOfChunksOf(whole: AssetReader, shown: Arriving | undefined): boolean {
  const there = shown?.isFinished ? shown.reader! : undefined;
  const facts = (reader: AssetReader): string =>
    JSON.stringify({ ...reader.facts, rowsReady: 0, facesReady: 0, hasDetail: false, hasSplats: false, hasColumns: false, rest: Array.from(reader.rest) });
  if (there?.chunkCount !== whole.chunkCount || facts(whole) !== facts(there)) return false;
  for (let i = 0; i < whole.chunkCount; ++i) if (whole.chunk(i).id !== there.chunk(i).id) return false;
  return true;
}
/** Gives a surface that arrives the chunks of the one that is shown, with the columns. */
function take(arriving: Arriving, shown: Arriving, add: () => void): void {
  [arriving.reader, shown.reader, arriving.look, arriving.before] = [shown.reader, undefined, shown.look, shown.reader!.facts.rank];
  add();
  arriving.checkFormat(arriving.reader!.facts.rank);
}

/** Where a surface that arrives differs by its columns alone from the one that is shown, these alone are fetched. False: it is another. */
export async function takeOver(arriving: Arriving, shown: Arriving, whole: AssetReader, manifest: Uint8Array): Promise<boolean> {
  if (!isOfChunksOf(whole, shown)) return false;
  const columns = await Columns.fetched(arriving, manifest);
  if (columns && shown.reader) take(arriving, shown, columns.read(shown.reader));
  return true;
}

/** Fetches the columns that a stream changes over to, says so, and lets its next epoch begin with them at once. */
export async function prepare(surfaces: SurfaceSource, asset: string, fetcher: ObjectFetcher, say: () => void): Promise<void> {
  const { shown, core, maxBytes } = surfaces;
  if (asset === surfaces.next?.asset || !(shown?.isFinished || shown?.isPreview)) return;
  surfaces.next?.fetcher.stop();
  const coming: NonNullable<SurfaceSource['next']> = (surfaces.next = { asset, fetcher });
  if (shown.isPreview) return say();  // A small picture takes no columns, and nobody has to wait for it.
  let whole: AssetReader | undefined;
  try {
    const manifest = await fetcher.get({ id: asset, maxBytes: MAX_MANIFEST_BYTES }, (bytes) => core.sha256(bytes) === asset);
    if (!manifest) return;
    whole = new (shown.reader!.constructor as typeof AssetReader)(core, asset, manifest, { maxBytes });  // Its code is loaded already.
    if (!whole.facts.hasColumns || !isOfChunksOf(whole, shown)) return;
    const columns = await Columns.fetched({ fetcher, totalBytes: 0 }, manifest);
    if (!columns || surfaces.shown !== shown) return;
    const add = columns.read(shown.reader!);
    coming.take = (arriving) => {
      take(arriving, shown, add);
      arriving.continues = true;
    };
    say();
  } catch (error) {
    console.warn(`eigencast: the stream's next surface: ${(error as Error).message}`);
  } finally {
    whole?.free();
  }
}
