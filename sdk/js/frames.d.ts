// SPDX-License-Identifier: MIT

/** As `format` in control messages. */
export interface Format {
  rows: number;
  channels?: number;
  band_ends: number[];
  codec: 'quantised' | 'float32' | 'float64';
  /** The last so many channels are velocities of the first, per velocity_us. */
  velocity_channels?: number;
  velocity_us?: number;
  /** Of the receiver's profile; what steps and estimates are made by. */
  scheme?: 'linear' | 'hermite' | 'damped';
}

/** rows x channels values, row-major. Quantised ones are integers: times stepSize(step) they are coefficients. */
export interface Key {
  bands: number;
  step: number;
  values: ArrayLike<number>;
}

export interface Frame {
  kind: 'key' | 'join' | 'step' | 'estimate';
  flags: number;
  bands: number;
  at: number;
  of: number;
  streamId: number;
  /** Of the epoch, as in `stream`: frames of another are not for this decoder. */
  tag: number;
  sequence: bigint;
  captureUs: bigint;
  /** Of all but joins. */
  pose?: Key;
  /** Of keys and joins that show a pose that leads up to them. */
  shown?: Key;
  /** Of joins. */
  older?: Key;
  newer?: Key;
  ageUs?: bigint;
}

export class ProtocolError extends Error {}

export function stepSize(index: number): number;

export class FrameDecoder {
  constructor(format: Format);
  restart(): void;
  /** Appends a segment of the memory that `remember` names; `asset`: the 32 bytes of its id. Throws ProtocolError. */
  addSegment(asset: Uint8Array, bytes: Uint8Array): void;
  /** Null where the frame needs keys that are not there: wait for a join. Throws ProtocolError on bytes that break the protocol. */
  decode(bytes: Uint8Array): Frame | null;
}
