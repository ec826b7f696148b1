// SPDX-License-Identifier: MIT
import { bytesFromHex, type Core } from './module.js';

/** `format` of a `stream` message (protocol.md, section 3). */
export interface Format {
  rows: number;
  channels: number;
  band_ends: number[];
  codec: 'float64' | 'float32' | 'quantised';
  velocity_channels: number;
  velocity_us: number;
  /** Of the channels between positions and velocities; empty: not known. */
  scalars: Scalar[];
}
/** A value of each vertex besides its position; the range to expect is unknown where low = high. */
export interface Scalar {
  name: string;
  unit: string;
  low: number;
  high: number;
  scale: number;
}
export type Scheme = 'linear' | 'catmull-rom' | 'hermite' | 'damped';

export const CODECS = ['float64', 'float32', 'quantised'] as const;
export const SCHEMES = ['linear', 'catmull-rom', 'hermite', 'damped'] as const;
export const KINDS = [undefined, 'key', 'join', 'step', 'estimate'] as const;

/** What a frame says itself: a key that is ahead shows not itself, but the step at/of up to it, or nothing. */
export interface FrameHead {
  kind: (typeof KINDS)[number];
  ahead: boolean;
  bands: number;
  at: number;
  of: number;
  streamId: number;
  epoch: number;
  sequence: bigint;
  captureUs: bigint;
}
/** What one frame gave: `head` wherever it follows what came before, `coefficients` where there is a pose to show. */
export interface Decoded {
  head: FrameHead | undefined;
  /** rows x channels, row-major: a view, of use until the next call of the core. */
  coefficients: Float64Array | undefined;
  /** Likewise, with the quantised codec: times the size of `step` they are the coefficients. */
  integers: Int32Array | undefined;
  step: number;
  /** When the pose holds. */
  shownUs: bigint;
  /** Once for each key that came ahead of the poses that lead up to it. */
  next: Next | undefined;
}
export interface Next {
  captureUs: bigint;
  bands: number;
  /** Likewise a view. */
  coefficients: Float64Array;
}
export interface Counts {
  keys: number;
  synthetic: number;
  joins: number;
  rejected: number;
  missed: number;
}

const MAX_SCALARS = 16, FORMAT_BYTES = 8 * MAX_SCALARS + 64;

/** A receiver's end of one stream's chain of keys. Call free() when done. */
export class Frames {
  readonly #core: Core;
  readonly #at: number;

  constructor(core: Core) {
    this.#core = core;
    this.#at = core.exports.frames_make();
  }
  free(): void {
    this.#core.exports.frames_free(this.#at);
  }

  /** Follows a `stream` message: another stream, tag, epoch or format starts the chain anew. Throws EigencastError. */
  begin(streamId: number, tag: number, epoch: number, format: Format | undefined, scheme: Scheme): void {
    const core = this.#core;
    if (format === undefined) {
      core.exports.frames_begin(this.#at, streamId, tag, epoch, 0);
      return;
    }
    core.checked(core.exports.frames_begin(this.#at, streamId, tag, epoch, givenFormat(core, format, scheme)));
  }
  restart(): void {
    this.#core.exports.frames_restart(this.#at);
  }

  /** Keys may be predicted from this segment of the memory of a surface's poses, too, behind those before. Throws EigencastError. */
  remember(asset: string, segment: Uint8Array): void {
    const core = this.#core, at = core.room(32 + segment.length);
    core.bytes(at, 32).set(bytesFromHex(asset));
    core.bytes(at + 32, segment.length).set(segment);
    core.checked(core.exports.frames_remember(this.#at, at, at + 32, segment.length));
  }
  forgetMemory(): void {
    this.#core.exports.frames_remember(this.#at, 0, 0, 0);
  }

  /** `error`: why the frame could not be decoded. */
  decode(frame: Uint8Array): Decoded & { error?: Error } {
    const core = this.#core;
    const status = core.exports.frames_decode(this.#at, core.given(frame), frame.length);
    const at = core.exports.frames_pose(this.#at);
    const data = core.data;
    const byte = (offset: number): number => data.getUint8(at + offset), word = (offset: number): number => data.getUint32(at + offset, true);
    const time = (offset: number): bigint => data.getBigInt64(at + offset, true);
    const count = word(48), integers = word(52);
    const head: FrameHead | undefined = byte(62) === 0 ? undefined : {
      kind: KINDS[byte(56)], ahead: (byte(57) & 1) !== 0, bands: byte(58), at: byte(59), of: byte(60), streamId: word(32), epoch: word(36),
      sequence: data.getBigUint64(at, true), captureUs: time(8),
    };
    return {
      head,
      step: byte(61),
      shownUs: time(16),
      next: word(44) === 0 ? undefined : { captureUs: time(24), bands: byte(63), coefficients: core.doubles(word(44), count) },
      coefficients: status === 1 ? core.doubles(word(40), count) : undefined,
      integers: status === 1 && integers !== 0 ? core.integers(integers, count) : undefined,
      ...(status < 0 ? { error: core.error() } : {}),
    };
  }

  get counts(): Counts {
    const at = this.#core.exports.frames_counts(this.#at);
    const data = this.#core.data;
    const count = (i: number): number => Number(data.getBigUint64(at + 8 * i, true));
    return { keys: count(0), synthetic: count(1), joins: count(2), rejected: count(3), missed: count(4) };
  }
}

/** The address of a core_format, in the room. */
export function givenFormat(core: Core, format: Format, scheme: Scheme): number {
  const at = core.room(FORMAT_BYTES), { scalars } = format;
  core.doubles(at, MAX_SCALARS).set(scalars.slice(0, MAX_SCALARS).map(({ scale }) => scale));
  core.words(at + 8 * MAX_SCALARS, 16).set([
    format.rows, format.channels, format.velocity_channels, format.velocity_us, CODECS.indexOf(format.codec), SCHEMES.indexOf(scheme), scalars.length,
    format.band_ends.length, ...format.band_ends.slice(0, 8),
  ]);
  return at;
}

/** The stream that a frame belongs to; nothing: it is not a frame. */
export function streamIdOf(core: Core, frame: Uint8Array): number | undefined {
  const id = Number(core.exports.frame_stream_id(core.given(frame), frame.length));
  return id < 0 ? undefined : id;
}
