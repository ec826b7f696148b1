// SPDX-License-Identifier: MIT
import { CODECS, SCHEMES, type Format, type Scalar, type Scheme } from '../core/frames.js';
import { EigencastError } from '../core/module.js';
import type { Profile } from './profile.js';

// Control messages (protocol.md, section 3): those that a broker sends to viewers, read and checked; those of a viewer, written.

export interface StreamInfo {
  stream: string;
  state: 'waiting' | 'live' | 'stalled';
  stream_id: number;
  /** 0 while waiting. */
  epoch: number;
  /** Stands for the epoch in frames. */
  tag: number;
  /** What this viewer gets. */
  profile: Required<Profile>;
  /** Nothing while waiting, and so are the next ones: 64 hexadecimal digits. */
  asset?: string;
  format?: Format;
  key_rate_hz?: number;
  /** 4 x 4 by columns: from the surface's coordinates to the scene's. */
  world?: number[];
  /** Since 1970, where its sender's clock of capture times says 0: utcOf(). */
  utc_us?: bigint;
  /** What the stream changes over to. */
  next?: { asset: string };
  /** What comes is of the past: the pose of capture time t is that of at_us + (t - capture_us) speed. */
  rewind?: { at_us: bigint; capture_us: bigint; speed: number };
}
/** What may be seen again of a stream, in microseconds since 1970, or (`code`) why a seek was not done. */
export interface History {
  stream: string;
  now_us: bigint;
  spans: { from_us: bigint; to_us: bigint }[];
  code: string;
  message: string;
}
/** What a viewer sends to see the past; `subscribe` returns to live. */
export interface Seek {
  stream: string;
  at_us: bigint | number;
  next?: boolean;
  /** 0, or 0.1 to 10. */
  speed?: number;
}
/** Which poses keys may be predicted from: the first `kept` segments of before, then these, by their hashes. */
export interface Remember {
  stream: string;
  generation: number;
  kept: number;
  segments: string[];
}
export type Message =
  | ({ op: 'stream' } & StreamInfo)
  | ({ op: 'remember' } & Remember)
  | { op: 'ping'; id: bigint; time_us: bigint }
  | { op: 'pong'; id: bigint; time_us: bigint; peer_time_us: bigint }
  | { op: 'notice'; message: string; stream: string; frames_dropped: number }
  | { op: 'error'; code: string; message: string; stream: string }
  | { op: 'bye'; reason: string; retry_after_ms: number };

const MAX_BYTES = 65536, MAX_DEPTH = 8, MAX_TEXT = 4096, MAX_CHANNELS = 16, MAX_SCALAR = 1e30;
const MAX_TIME = 2n ** 62n - 1n;
const MAX_SPEED = 10;
const BIG = '\u0001big:';
const STATES = ['waiting', 'live', 'stalled'] as const;

type Json = { [name: string]: unknown };

/** The text with integers that doubles may not hold as marked strings, in one pass. Throws EigencastError (too-large). */
function marked(text: string): string {
  const parts: string[] = [];
  let from = 0, depth = 0;
  for (let i = 0; i < text.length;) {
    const c = text[i]!;
    if (c === '"') {
      for (++i; i < text.length && text[i] !== '"';) i += text[i] === '\\' ? 2 : 1;
      ++i;
    } else if (c === '-' || (c >= '0' && c <= '9')) {
      const start = i++;
      while (i < text.length && /[0-9.eE+-]/.test(text[i]!)) ++i;
      const number = text.slice(start, i);
      if (number.length < 16 || !/^-?\d+$/.test(number)) continue;
      parts.push(text.slice(from, start), '"\\u0001big:', number, '"');
      from = i;
    } else {
      if (c === '{' || c === '[') ++depth;
      if (c === '}' || c === ']') --depth;
      if (depth > MAX_DEPTH) throw new EigencastError('too-large', 'control message: nested too deep');
      ++i;
    }
  }
  return parts.join('') + text.slice(from);
}

/** JSON with those integers as bigint: times reach 2^62, sequences 2^64. */
function parse(text: string): unknown {
  return JSON.parse(text, (_, value) =>
    typeof value === 'string' && value.startsWith(BIG) && /^-?\d{1,20}$/.test(value.slice(BIG.length)) ? BigInt(value.slice(BIG.length)) : value);
}

/** Takes typed fields out of one object, each checked. */
export class Fields {
  constructor(readonly json: Json, readonly path: string) {}

  wrong(name: string, what: string): never {
    throw new EigencastError('corrupt', `control message: field '${this.path}${name}' ${what}`);
  }
  has(name: string): boolean {
    return Object.hasOwn(this.json, name);
  }
  #get(name: string): unknown {
    return this.has(name) ? this.json[name] : this.wrong(name, 'is missing');
  }
  big(name: string, low = 0n, high = 2n ** 64n - 1n, otherwise?: bigint): bigint {
    if (otherwise !== undefined && !this.has(name)) return otherwise;
    const value = this.#get(name);
    const integer = typeof value === 'bigint' ? value : Number.isSafeInteger(value) ? BigInt(value as number) : undefined;
    return integer !== undefined && integer >= low && integer <= high ? integer : this.wrong(name, `must be an integer of ${low} to ${high}`);
  }
  integer(name: string, low: number, high: number, otherwise?: number): number {
    return Number(this.big(name, BigInt(low), BigInt(high), otherwise === undefined ? undefined : BigInt(otherwise)));
  }
  id(name: string): number {
    return this.integer(name, 0, 0xffffffff);
  }
  time(name: string): bigint {
    return this.big(name, 0n, MAX_TIME);
  }
  number(name: string, low: number, high: number, otherwise?: number): number {
    const given = otherwise !== undefined && !this.has(name) ? otherwise : this.#get(name), value = typeof given === 'bigint' ? Number(given) : given;
    return typeof value === 'number' && value >= low && value <= high ? value : this.wrong(name, `must be a number of ${low} to ${high}`);
  }
  text(name: string, otherwise?: string): string {
    const value = otherwise !== undefined && !this.has(name) ? otherwise : this.#get(name);
    return typeof value === 'string' && value.length <= MAX_TEXT ? value : this.wrong(name, 'must be a string of at most 4096 bytes');
  }
  word<Word extends string>(name: string, words: readonly Word[], otherwise?: Word): Word {
    const value = this.text(name, otherwise);
    return words.find((word) => word === value) ?? this.wrong(name, `must be one of: ${words.join(', ')}`);
  }
  array(name: string, least: number, most: number): unknown[] {
    const value = this.#get(name);
    return Array.isArray(value) && value.length >= least && value.length <= most ? value : this.wrong(name, `must be an array of ${least} to ${most} elements`);
  }
  object(name: string, otherwise?: Json): Fields {
    return fieldsOf(otherwise !== undefined && !this.has(name) ? otherwise : this.#get(name), `${this.path}${name}.`);
  }
}

function fieldsOf(value: unknown, path: string): Fields {
  if (typeof value === 'object' && value !== null && !Array.isArray(value)) return new Fields(value as Json, path);
  throw new EigencastError('corrupt', `control message: ${path === '' ? 'it is not a JSON object' : `field '${path.slice(0, -1)}' must be an object`}`);
}

export function formatOf(fields: Fields): Format {
  const rows = fields.integer('rows', 1, 4096), channels = fields.integer('channels', 1, MAX_CHANNELS, 3);
  const ends = fields.array('band_ends', 1, 8).map((end) => (Number.isInteger(end) ? (end as number) : fields.wrong('band_ends', 'must hold integers')));
  if (ends.some((end, i) => end <= (ends[i - 1] ?? 0)) || ends.at(-1) !== rows) fields.wrong('band_ends', 'must ascend strictly up to rows');
  if (rows * channels > 32768) fields.wrong('rows', 'times channels must be at most 32768');
  const moving = fields.integer('velocity_channels', 0, Math.floor(channels / 2), 0);
  const scalars = fields.has('scalars') ? fields.array('scalars', 0, MAX_CHANNELS).map((one) => scalarOf(fieldsOf(one, 'format.scalars.'))) : [];
  if (scalars.length > 0 && (3 + scalars.length + moving !== channels || new Set(scalars.map(({ name }) => name)).size < scalars.length))
    fields.wrong('scalars', 'must name each channel between positions and velocities, or none');
  return {
    rows, channels, band_ends: ends, codec: fields.word('codec', CODECS), velocity_channels: moving,
    velocity_us: fields.integer('velocity_us', 1, 10_000_000, 1_000_000), scalars,
  };
}

function scalarOf(fields: Fields): Scalar {
  const name = fields.text('name'), unit = fields.text('unit', ''), low = fields.number('low', -MAX_SCALAR, MAX_SCALAR, 0);
  if (!/^[A-Za-z0-9._-]{1,64}$/.test(name) || name === '.' || name === '..') fields.wrong('name', 'must be 1 to 64 of A-Z a-z 0-9 . _ -');
  if (/[\0-\x1f\x7f]/.test(unit) || new TextEncoder().encode(unit).length > 16) fields.wrong('unit', 'must be at most 16 bytes');
  return { name, unit, low, high: fields.number('high', low, MAX_SCALAR, 0), scale: fields.number('scale', 1 / MAX_SCALAR, MAX_SCALAR) };
}

function profileOf(fields: Fields): Required<Profile> {
  const rate = fields.word('rate', ['raw', 'interpolated', 'estimated'], 'interpolated');
  return {
    rate, k: fields.integer('k', 2, 15, 3), scheme: fields.word<Scheme>('scheme', SCHEMES, rate === 'estimated' ? 'damped' : 'linear'),
    bands: fields.integer('bands', 1, 8, 8),
  };
}

export function assetOf(fields: Fields): string {
  const asset = fields.text('asset');
  return /^[0-9a-f]{64}$/.test(asset) ? asset : fields.wrong('asset', 'must be 64 lower-case hexadecimal digits');
}

/** Of an announced stream; 0n: its sender does not say it. */
export function utcIn(fields: Fields): bigint {
  return fields.big('utc_us', -MAX_TIME, MAX_TIME, 0n);
}

function streamOf(fields: Fields): Message {
  const state = fields.word('state', STATES);
  const info: { op: 'stream' } & StreamInfo = {
    op: 'stream', stream: fields.text('stream'), state, stream_id: fields.id('stream_id'), epoch: fields.id('epoch'), tag: 0,
    profile: profileOf(fields.object('profile', {})),
  };
  if (state !== 'waiting') {
    info.tag = fields.integer('tag', 0, 255);
    info.asset = assetOf(fields);
    info.format = formatOf(fields.object('format'));
    info.key_rate_hz = fields.number('key_rate_hz', 0, 10_000, 0);
    info.utc_us = utcIn(fields);
  }
  if (fields.has('next')) {
    const next = fields.object('next');
    if (next.has('asset')) info.next = { asset: assetOf(next) };
  }
  if (fields.has('rewind')) {
    const rewind = fields.object('rewind'), speed = rewind.number('speed', 0, MAX_SPEED);
    if (speed > 0 && speed < 1 / MAX_SPEED) rewind.wrong('speed', `must be 0, or ${1 / MAX_SPEED} to ${MAX_SPEED}`);
    info.rewind = { at_us: rewind.time('at_us'), capture_us: rewind.time('capture_us'), speed };
  }
  if (fields.has('world')) {
    const world = fields.array('world', 16, 16);
    if (!world.every((value) => typeof value === 'number' || typeof value === 'bigint')) fields.wrong('world', 'must hold 16 numbers');
    info.world = world.map(Number);
  }
  return info;
}

export const READERS = {
  stream: streamOf,
  remember: (f: Fields) => ({
    op: 'remember' as const, stream: f.text('stream'), generation: f.id('generation'), kept: f.integer('kept', 0, 256, 0),
    segments: f.array('segments', 0, 256).map(String),
  }),
  ping: (f: Fields) => ({ op: 'ping' as const, id: f.big('id'), time_us: f.time('time_us') }),
  pong: (f: Fields) => ({ op: 'pong' as const, id: f.big('id'), time_us: f.time('time_us'), peer_time_us: f.time('peer_time_us') }),
  notice: (f: Fields) => ({ op: 'notice' as const, message: f.text('message'), stream: f.text('stream', ''), frames_dropped: Number(f.big('frames_dropped', 0n, undefined, 0n)) }),
  error: (f: Fields) => ({ op: 'error' as const, code: f.text('code'), message: f.text('message'), stream: f.text('stream', '') }),
  bye: (f: Fields) => ({ op: 'bye' as const, reason: f.text('reason', ''), retry_after_ms: f.integer('retry_after_ms', 0, 0xffffffff, 0) }),
};

/** Nothing: a message of a kind that `readers`, those of viewers, do not read. Throws EigencastError (corrupt, too-large). */
export function readControl(text: string): Message | undefined;
export function readControl<Readers extends Record<string, (fields: Fields) => unknown>>(text: string, readers: Readers): ReturnType<Readers[keyof Readers]> | undefined;
export function readControl(text: string, readers: Record<string, (fields: Fields) => unknown> = READERS): unknown {
  if (text.length > MAX_BYTES) throw new EigencastError('too-large', `control message: longer than ${MAX_BYTES} bytes`);
  const prepared = marked(text);
  let json: unknown;
  try {
    json = parse(prepared);
  } catch {
    throw new EigencastError('corrupt', 'control message: it is not JSON');
  }
  const fields = fieldsOf(json, '');
  const op = fields.text('op');
  return Object.hasOwn(readers, op) ? readers[op]!(fields) : undefined;
}

/** Of bigint, numbers, texts, arrays and objects of those. */
export function writeControl(op: string, fields: object): string {
  const written = (value: unknown): string => {
    if (typeof value === 'bigint') return String(value);
    if (Array.isArray(value)) return `[${value.map(written).join(',')}]`;
    if (typeof value !== 'object' || value === null) return JSON.stringify(value);
    return `{${Object.entries(value).map(([name, one]) => `${JSON.stringify(name)}:${written(one)}`).join(',')}}`;
  };
  return written({ op, ...fields });
}
