// SPDX-License-Identifier: MIT
import { bytesFromHex, hexFrom, type Core } from './module.js';

export interface Chunk {
  /** 64 hexadecimal digits. */
  id: string;
  bytes: number;
  /** Leading bytes that suffice for the bands asked for. */
  neededBytes: number;
  firstRow: number;
  endRow: number;
}
export interface AssetFacts {
  name: string;
  vertexCount: number;
  rank: number;
  baseCount: number;
  faceTotal: number;
  rowsReady: number;
  facesReady: number;
  bandEnds: number[];
  upAxis: 'unknown' | 'x' | 'y' | 'z';
  isLeftHanded: boolean;
  /** 0: unknown. */
  metresPerUnit: number;
  boxLow: [number, number, number];
  boxHigh: [number, number, number];
  origin: [number, number, number];
  hasDetail: boolean;
  hasSplats: boolean;
  /** Its stream has learnt columns, which are fetched beside the chunks. */
  hasColumns: boolean;
  /** Of the surface, or of its points' discs; surface units squared. */
  area: number;
}

const UP_AXES = ['unknown', 'x', 'y', 'z'] as const;

/** A surface as it arrives, chunk by chunk. Errors are EigencastErrors. Call free() when done. */
export class AssetReader {
  readonly core: Core;
  readonly at: number;
  #next = 0;
  #freed = false;

  /**
   * id        64 hexadecimal digits that the manifest must hash to
   * bands     how many of the lowest are wanted; 0: all
   * maxBytes  what the whole may take in memory; more is refused
   */
  constructor(core: Core, id: string, manifest: Uint8Array, { bands = 0, maxBytes = 2 ** 30 } = {}) {
    this.core = core;
    const at = core.room(manifest.length + 32);
    core.bytes(at, 32).set(bytesFromHex(id));
    core.bytes(at + 32, manifest.length).set(manifest);
    this.at = core.found(core.exports.asset_open(at, at + 32, manifest.length, bands, maxBytes));
    core.tidy();
  }
  /** Again does nothing. */
  free(): void {
    if (!this.#freed) this.core.exports.asset_free(this.at);
    this.#freed = true;
  }

  get chunkCount(): number {
    return this.core.exports.asset_chunk_count(this.at);
  }
  /** The number of the chunk that comes next. */
  get next(): number {
    return this.#next;
  }
  get isComplete(): boolean {
    return this.#next === this.chunkCount;
  }
  chunk(index: number): Chunk {
    const at = this.core.found(this.core.exports.asset_chunk(this.at, index));
    const [bytes = 0, neededBytes = 0, firstRow = 0, endRow = 0] = this.core.words(at + 32, 4);
    return { id: hexFrom(this.core.bytes(at, 32)), bytes, neededBytes, firstRow, endRow };
  }
  /** Adds the next chunk, whole or its first neededBytes. After an error nothing has changed. */
  add(bytes: Uint8Array): void {
    const at = this.core.given(bytes);
    this.core.checked(this.core.exports.asset_add(this.at, this.#next, at, bytes.length));
    this.core.tidy();
    ++this.#next;
  }

  get facts(): AssetFacts {
    const at = this.core.exports.asset_facts(this.at);
    const data = this.core.data;
    const doubles = this.core.doubles(at, 10);
    const vector = (first: number): [number, number, number] =>
      [doubles[first]!, doubles[first + 1]!, doubles[first + 2]!];
    const word = (i: number): number => data.getUint32(at + 84 + 4 * i, true);
    return {
      name: this.core.text(data.getUint32(at + 172, true)),
      vertexCount: word(0), rank: word(1), baseCount: word(2), faceTotal: word(3), rowsReady: word(4), facesReady: word(5),
      upAxis: UP_AXES[word(6)] ?? 'unknown', isLeftHanded: word(7) !== 0,
      bandEnds: Array.from({ length: word(8) }, (_, i) => word(9 + i)),
      hasDetail: word(17) !== 0, hasSplats: word(18) !== 0, hasColumns: word(25) !== 0, area: data.getFloat64(at + 176, true),
      metresPerUnit: doubles[0]!, boxLow: vector(1), boxHigh: vector(4), origin: vector(7),
    };
  }
  get rank(): number {
    return this.core.data.getUint32(this.core.exports.asset_facts(this.at) + 88, true);
  }
  /** rank x 3: copied. */
  get rest(): Float64Array {
    const at = this.core.exports.asset_facts(this.at), { rank } = this;
    return this.core.doubles(this.core.data.getUint32(at + 80, true), 3 * rank).slice();
  }
  /** rowsReady: the row that each contracts to; a view, of use until the next call of the core. */
  get map(): Uint32Array {
    const at = this.core.exports.asset_facts(this.at), data = this.core.data;
    return this.core.words(data.getUint32(at + 188, true), data.getUint32(at + 100, true));
  }
  /** rowsReady x 3, sRGB: copied; nothing: it has none. */
  get colours(): Uint8Array | undefined {
    const at = this.core.exports.asset_facts(this.at);
    const data = this.core.data;
    const colours = data.getUint32(at + 160, true);
    return colours === 0 ? undefined : this.core.bytes(colours, 3 * data.getUint32(at + 100, true)).slice();
  }
  /** rowsReady: the file's own: 0 none, 1 smooth, 2 hard: copied; nothing: it has none. */
  get normals(): Uint8Array | undefined {
    const at = this.core.exports.asset_facts(this.at), data = this.core.data, normals = data.getUint32(at + 192, true);
    return normals === 0 ? undefined : this.core.bytes(normals, data.getUint32(at + 100, true)).slice();
  }
  /** A PNG or JPEG: copied; nothing: it has none, or it has not arrived. */
  get image(): Uint8Array | undefined {
    const at = this.core.exports.asset_facts(this.at);
    const data = this.core.data;
    const image = data.getUint32(at + 164, true);
    return image === 0 ? undefined : this.core.bytes(image, data.getUint32(at + 168, true)).slice();
  }
  /** `coefficients` with the rows of bands that did not come as in the rest pose. */
  filled(coefficients: ArrayLike<number>, channels: number, bands: number): Float64Array {
    const at = this.core.givenDoubles(coefficients);
    this.core.checked(this.core.exports.asset_fill(this.at, at, coefficients.length, channels, bands));
    return this.core.doubles(at, coefficients.length).slice();
  }
}
