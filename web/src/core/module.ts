// SPDX-License-Identifier: MIT

/** What eigencast-core.wasm exports: web/core/core.h. Addresses and sizes are numbers, 64-bit integers bigint. */
export interface Exports {
  readonly memory: WebAssembly.Memory;
  _initialize(): void;
  memory_take(bytes: number): number;
  memory_give(taken: number): void;
  error_text(): number;
  hash_sha256(bytes: number, size: number, digest: number): void;
  frame_stream_id(bytes: number, size: number): bigint;
  frames_make(): number;
  frames_free(frames: number): void;
  frames_begin(frames: number, streamId: number, tag: number, epoch: number, format: number): number;
  frames_restart(frames: number): void;
  frames_remember(frames: number, asset: number, segment: number, size: number): number;
  frames_decode(frames: number, bytes: number, size: number): number;
  frames_pose(frames: number): number;
  frames_counts(frames: number): number;
  playout_make(): number;
  playout_free(playout: number): void;
  playout_set(playout: number, mode: number, smoothness: number, delayUs: bigint, maxAheadUs: bigint): number;
  playout_bands(playout: number, ends: number, bands: number): number;
  playout_add(playout: number, timeUs: bigint, arrivalUs: bigint, coefficients: number, count: number, bands: number, isEstimate: number): number;
  playout_add_next(playout: number, timeUs: bigint, coefficients: number, count: number, bands: number): number;
  playout_at(playout: number, nowUs: bigint): number;
  playout_keep_lag(playout: number, lagUs: bigint): bigint;
  playout_delay_us(playout: number): bigint;
  playout_reset(playout: number): void;
  asset_open(id: number, manifest: number, size: number, bands: number, maxBytes: number): number;
  asset_free(asset: number): void;
  asset_chunk_count(asset: number): number;
  asset_chunk(asset: number, index: number): number;
  asset_add(asset: number, index: number, bytes: number, size: number): number;
  asset_facts(asset: number): number;
  asset_widen(asset: number, columns: number): number;
  asset_fill(asset: number, coefficients: number, count: number, channels: number, bands: number): number;
  surface_make(): number;
  surface_free(surface: number): void;
  surface_update(surface: number, asset: number): number;
  surface_rebuild(surface: number, asset: number, coefficients: number, count: number, channels: number, rank: number, level: number, isTextured: number, pxPerUnit: number, nowUs: bigint): number;
  surface_points(surface: number, asset: number, coefficients: number, count: number, channels: number, vertices: number, points: number): number;
  asset_source(asset: number, vertex: number, isTextured: number): number;
  surface_numbers(surface: number, asset: number, coefficients: number, count: number, isLength: number): number;
}

/** What the core, or the broker, refuses: `code` is one of protocol.md, section 10. */
export class EigencastError extends Error {
  override readonly name = 'EigencastError';
  constructor(readonly code: string, message: string) {
    super(message);
  }
}

/**
 * An instance of eigencast-core.wasm: its memory, and errors as exceptions. What its memory held is of no use after a
 * WebAssembly.RuntimeError, which stands for memory that ran out: make another.
 */
export class Core {
  readonly exports: Exports;
  #room = 0;
  #roomBytes = 0;

  private constructor(exports: Exports) {
    this.exports = exports;
  }

  /** `module`: a compiled module, or its bytes. Instances share nothing. */
  static async make(module: WebAssembly.Module | BufferSource): Promise<Core> {
    const compiled = module instanceof WebAssembly.Module ? module : await WebAssembly.compile(module);
    const instance = await WebAssembly.instantiate(compiled, { wasi_snapshot_preview1: refusals(compiled) });
    const exports = instance.exports as unknown as Exports;
    exports._initialize();
    return new Core(exports);
  }

  get bytesOfMemory(): number {
    return this.exports.memory.buffer.byteLength;
  }

  /** Views of the memory, of use until the next call. */
  get data(): DataView {
    return new DataView(this.exports.memory.buffer);
  }
  bytes(at: number, count: number): Uint8Array {
    return new Uint8Array(this.exports.memory.buffer, at, count);
  }
  words(at: number, count: number): Uint32Array {
    return new Uint32Array(this.exports.memory.buffer, at, count);
  }
  integers(at: number, count: number): Int32Array {
    return new Int32Array(this.exports.memory.buffer, at, count);
  }
  floats(at: number, count: number): Float32Array {
    return new Float32Array(this.exports.memory.buffer, at, count);
  }
  doubles(at: number, count: number): Float64Array {
    return new Float64Array(this.exports.memory.buffer, at, count);
  }
  text(at: number): string {
    const all = new Uint8Array(this.exports.memory.buffer, at);
    return new TextDecoder().decode(all.subarray(0, all.indexOf(0)));
  }

  /** Room for what is given to one call, aligned for doubles; the next call of room() takes it again. */
  room(bytes: number): number {
    if (bytes > this.#roomBytes) {
      this.exports.memory_give(this.#room);
      this.#roomBytes = Math.max(bytes, 4096);
      this.#room = this.exports.memory_take(this.#roomBytes);
      if (this.#room === 0) {
        this.#roomBytes = 0;
        throw new EigencastError('too-large', `no room for ${bytes} bytes`);
      }
    }
    return this.#room;
  }
  /** Gives large rooms back. */
  tidy(): void {
    if (this.#roomBytes <= 65536) return;
    this.exports.memory_give(this.#room);
    this.#room = this.#roomBytes = 0;
  }
  /** The address of a copy of `bytes`, in the room. */
  given(bytes: Uint8Array): number {
    const at = this.room(bytes.length);
    this.bytes(at, bytes.length).set(bytes);
    return at;
  }
  givenDoubles(values: ArrayLike<number>): number {
    const at = this.room(8 * values.length);
    this.doubles(at, values.length).set(values);
    return at;
  }

  /** `result`, unless it stands for an error. */
  checked(result: number): number {
    if (result < 0) throw this.error();
    return result;
  }
  /** The address, unless it is null. */
  found(address: number): number {
    if (address === 0) throw this.error();
    return address;
  }
  error(): EigencastError {
    const text = this.text(this.exports.error_text());
    const end = text.indexOf(': ');
    return new EigencastError(text.slice(0, end), text.slice(end + 2));
  }

  /** 64 hexadecimal digits. */
  sha256(bytes: Uint8Array): string {
    const at = this.room(bytes.length + 32);
    this.bytes(at, bytes.length).set(bytes);
    this.exports.hash_sha256(at, bytes.length, at + bytes.length);
    return hexFrom(this.bytes(at + bytes.length, 32));
  }
}

/** libc would write messages and ask for the environment before it aborts: nothing of that is granted. */
function refusals(module: WebAssembly.Module): Record<string, () => number> {
  const NOT_CAPABLE = 76;
  const imports = WebAssembly.Module.imports(module).filter((one) => one.module === 'wasi_snapshot_preview1');
  return Object.fromEntries(imports.map((one) => [one.name, () => NOT_CAPABLE]));
}

export function hexFrom(bytes: Uint8Array): string {
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, '0')).join('');
}

/** Of 64 hexadecimal digits. */
export function bytesFromHex(hex: string): Uint8Array {
  if (!/^[0-9a-f]{64}$/.test(hex)) throw new EigencastError('corrupt', `"${hex.slice(0, 80)}" is not an asset's id`);
  return Uint8Array.from({ length: 32 }, (_, i) => parseInt(hex.slice(2 * i, 2 * i + 2), 16));
}
