// SPDX-License-Identifier: MIT
import { givenFormat, type Format } from './frames.js';
import type { Core } from './module.js';

/** What eigencast-writer.wasm exports, beside what it has of a Core's: web/core/writer.h. */
interface Exports {
  writer_make(format: number, error: number, area: number): number;
  writer_free(writer: number): void;
  writer_begin(writer: number, streamId: number, tag: number): void;
  writer_frame(writer: number, coefficients: number, count: number, captureUs: bigint): number;
  writer_bytes(writer: number): number;
}

/** A sender's end of one stream's chain of keys. Errors are EigencastErrors. Call free() when done. */
export class Writer {
  readonly #core: Core;
  readonly #exports: Exports;
  readonly #at: number;

  /**
   * core   an instance of eigencast-writer.wasm
   * error  of quantising: area-weighted rms over the surface, surface units
   * area   of the surface
   */
  constructor(core: Core, format: Format, error: number, area: number) {
    this.#core = core;
    this.#exports = core.exports as unknown as Exports;
    this.#at = core.found(this.#exports.writer_make(givenFormat(core, format, 'linear'), error, area));
  }
  free(): void {
    this.#exports.writer_free(this.#at);
  }
  /** Follows `announced`: a chain begins. */
  begin(streamId: number, tag: number): void {
    this.#exports.writer_begin(this.#at, streamId, tag);
  }
  /** The next frame, which counts as sent: a view, of use until the next call. */
  frame(coefficients: ArrayLike<number>, captureUs: bigint): Uint8Array {
    const core = this.#core;
    const size = core.checked(this.#exports.writer_frame(this.#at, core.givenDoubles(coefficients), coefficients.length, captureUs));
    return core.bytes(this.#exports.writer_bytes(this.#at), size);
  }
}
