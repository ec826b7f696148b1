// SPDX-License-Identifier: MIT
import { EigencastError } from '../core/module.js';

// Recordings (docs/recording-format.md), read in parts: common/recording/reader.h.

/** Bytes to read from. */
export interface Source {
  size: number;
  read(from: number, end: number): Promise<Uint8Array>;
}
export const TYPES = ['', 'start', 'announce', 'frame', 'checkpoint', 'object', 'index', 'end', 'gap', 'memory'] as const;
export interface Record {
  type: (typeof TYPES)[number] | undefined;
  /** Microseconds since the start of the recording. */
  timeUs: number;
  body: Uint8Array;
  /** Where the next one begins. */
  end: number;
}
/** Where reading may begin. */
export interface Entry {
  timeUs: number;
  checkpoint: number;
  announce: number;
}

const HEAD_BYTES = 17, END_BYTES = HEAD_BYTES + 24, HEADER_BYTES = 12, ENTRY_BYTES = 24, MAX_BODY_BYTES = 2 ** 28 + 32, VERSION = 2;
const BLOCK_BYTES = 1 << 17, MAX_BLOCKS = 32, MAX_WHOLE_BYTES = 2 ** 30;

const TABLE = Uint32Array.from({ length: 256 }, (_, i) => {
  let value = i;
  for (let bit = 0; bit < 8; ++bit) value = value & 1 ? (value >>> 1) ^ 0x82f63b78 : value >>> 1;
  return value >>> 0;
});
/** CRC-32C of all parts, one after the other. */
export function crc32c(...parts: Uint8Array[]): number {
  let crc = 0xffffffff;
  for (const part of parts) for (const byte of part) crc = TABLE[(crc ^ byte) & 255]! ^ (crc >>> 8);
  return ~crc >>> 0;
}

function corrupt(why: string): never {
  throw new EigencastError('corrupt', why);
}

function sourceOfBlob(blob: Blob): Source {
  return { size: blob.size, read: async (from, end) => new Uint8Array(await blob.slice(from, end).arrayBuffer()) };
}
/** A file, or a URL: by Range where its server does, else as a whole. Throws EigencastError. */
export async function sourceOf(what: Blob | string): Promise<Source> {
  if (typeof what !== 'string') return sourceOfBlob(what);
  const ask = async (from: number, end: number): Promise<Response> => {
    const headers: HeadersInit = end < Infinity ? { Range: `bytes=${from}-${end - 1}` } : {};
    const answer = await fetch(what, { headers }).catch(() => undefined);
    if (!answer) throw new EigencastError('unreachable', `${what} cannot be reached: no server answers, or its pages or this one's policy forbid it`);
    if (!answer.ok) throw new EigencastError(answer.status === 404 ? 'not-found' : 'refused', `${what}: the server answered ${answer.status}`);
    return answer;
  };
  const first = await ask(0, BLOCK_BYTES), size = Number(/\/(\d+)$/.exec(first.headers.get('Content-Range') ?? '')?.[1] ?? NaN);
  if (first.status !== 206 || !Number.isSafeInteger(size)) {
    // Servers of other origins may hide of how much it is a part.
    const whole = first.status === 206 ? await ask(0, Infinity) : first;
    if (Number(whole.headers.get('Content-Length') ?? 0) > MAX_WHOLE_BYTES) throw new EigencastError('too-large', `${what}: over 1 GiB, and its server gives no parts of it (Range)`);
    return sourceOfBlob(await whole.blob());
  }
  return { size, read: async (from, end) => new Uint8Array(await (await ask(from, end)).arrayBuffer()) };
}

/** A recording, of which no more is read than is asked for, but where its end is missing: then all of it, once. */
export class RecordingReader {
  readonly #source: Source;
  readonly #blocks = new Map<number, Promise<Uint8Array>>();
  readonly #objects = new Map<string, number>();
  /** Where objects are to be looked for, one after the other: from, end. */
  #regions: [number, number][] | undefined;
  #first = HEADER_BYTES;
  /** Up to the end of the last whole record. */
  #end: number;
  stream = '';
  startedMs = 0;
  durationUs = 0;
  entries: Entry[] = [];

  private constructor(source: Source) {
    this.#source = source;
    this.#end = source.size;
  }
  /** Throws EigencastError (corrupt, incompatible-version, and those of the source). */
  static async open(source: Source): Promise<RecordingReader> {
    const reader = new RecordingReader(source), header = await reader.#bytes(0, HEADER_BYTES);
    if (header.length < HEADER_BYTES || new TextDecoder().decode(header.subarray(0, 8)) !== 'ECRECOR\n') corrupt('this is not a recording: it does not begin with ECRECOR');
    const version = new DataView(header.buffer, header.byteOffset).getUint32(8, true);
    if (version !== VERSION) throw new EigencastError('incompatible-version', `recording version ${version}, and this page reads version ${VERSION}`);
    const start = await reader.at(HEADER_BYTES);
    if (start?.type !== 'start' || start.body.length < 10) corrupt('the recording has no beginning');
    const view = viewOf(start.body);
    reader.startedMs = Number(view.getBigUint64(0, true) / 1000n);
    reader.stream = new TextDecoder().decode(start.body.subarray(9, 9 + view.getUint8(8)));
    reader.#first = start.end;
    if (!(await reader.#loadEnd())) await reader.#scan();
    if (reader.entries.length === 0) corrupt('the recording holds no pose');
    return reader;
  }

  /** The whole record at an offset; nothing: there is none, or it is damaged. */
  async at(offset: number): Promise<Record | undefined> {
    const head = await this.#head(offset);
    if (!head) return undefined;
    const body = await this.#bytes(offset + HEAD_BYTES, head.end);
    return crc32c(head.bytes.subarray(0, 13), body) === head.crc ? { type: head.type, timeUs: head.timeUs, body, end: head.end } : undefined;
  }
  /** The last place to begin at or before a time, or the first. */
  entryAt(timeUs: number): Entry {
    const later = this.entries.findIndex((entry) => entry.timeUs > timeUs);
    return this.entries[Math.max(0, (later < 0 ? this.entries.length : later) - 1)]!;
  }
  /** An object of a surface or memory; nothing: the recording does not hold it. */
  async object(id: string): Promise<Uint8Array | undefined> {
    this.#regions ??= [...this.#likelyRegions(), [this.#first, this.#end]];
    while (!this.#objects.has(id) && this.#regions.length > 0) await this.#findObjects(...this.#regions.shift()!);
    const offset = this.#objects.get(id), record = offset === undefined ? undefined : await this.at(offset);
    return record?.body.subarray(32);
  }

  /** They are written before and behind announcements: between the last checkpoint before one and the first behind it. */
  #likelyRegions(): [number, number][] {
    const isFirst = ({ announce }: Entry, i: number): boolean => announce !== this.entries[i - 1]?.announce;
    return this.entries.flatMap((entry, i) => (isFirst(entry, i) ? [[this.entries[i - 1]?.checkpoint ?? this.#first, entry.checkpoint] as [number, number]] : []));
  }
  async #findObjects(from: number, end: number): Promise<void> {
    for (let offset = from; offset < end;) {
      const head = await this.#head(offset);
      if (!head) return;
      if (head.type === 'object') {
        const id = await this.#bytes(offset + HEAD_BYTES, offset + HEAD_BYTES + 32);
        this.#objects.set(Array.from(id, (byte) => byte.toString(16).padStart(2, '0')).join(''), offset);
      }
      offset = head.end;
    }
  }
  async #loadEnd(): Promise<boolean> {
    const end = this.#end < this.#first + END_BYTES ? undefined : await this.at(this.#end - END_BYTES);
    if (end?.type !== 'end' || end.body.length !== END_BYTES - HEAD_BYTES) return false;
    this.durationUs = end.timeUs;
    const entries: Entry[] = [];
    for (let offset = numberAt(end.body, 0), before = this.#end; offset !== 0;) {
      const block = offset < before && offset >= this.#first ? await this.at(offset) : undefined;
      if (block?.type !== 'index' || block.body.length % ENTRY_BYTES !== 8) return false;
      [before, offset] = [offset, numberAt(block.body, 0)];
      for (let i = 8; i < block.body.length; i += ENTRY_BYTES)
        entries.push({ timeUs: numberAt(block.body, i), checkpoint: numberAt(block.body, i + 8), announce: numberAt(block.body, i + 16) });
    }
    this.entries = entries.sort((a, b) => a.checkpoint - b.checkpoint);
    return entries.every(({ announce, checkpoint, timeUs }, i) => announce >= this.#first && announce < checkpoint && checkpoint < this.#end && timeUs >= (entries[i - 1]?.timeUs ?? 0));
  }
  async #scan(): Promise<void> {
    let offset = this.#first, announce = 0;
    this.entries = [];
    for (let record = await this.at(offset); record && record.timeUs >= this.durationUs; record = await this.at(offset)) {
      this.durationUs = record.timeUs;
      if (record.type === 'announce') announce = offset;
      if (record.type === 'checkpoint' && announce !== 0) this.entries.push({ timeUs: record.timeUs, checkpoint: offset, announce });
      offset = record.end;
    }
    this.#end = offset;
  }
  async #head(offset: number): Promise<{ type: Record['type']; timeUs: number; crc: number; end: number; bytes: Uint8Array } | undefined> {
    if (offset + HEAD_BYTES > this.#end) return undefined;
    const bytes = await this.#bytes(offset, offset + HEAD_BYTES), view = viewOf(bytes), end = offset + HEAD_BYTES + view.getUint32(0, true), time = view.getBigUint64(5, true);
    if (view.getUint32(0, true) > MAX_BODY_BYTES || end > this.#end || time >= 2n ** 53n) return undefined;
    return { type: TYPES[view.getUint8(4)], timeUs: Number(time), crc: view.getUint32(13, true), end, bytes };
  }
  /** By blocks, the last of which are kept. */
  async #bytes(from: number, end: number): Promise<Uint8Array> {
    const last = Math.min(end, this.#source.size), first = Math.floor(from / BLOCK_BYTES), count = Math.ceil(last / BLOCK_BYTES) - first;
    const blocks = await Promise.all(Array.from({ length: Math.max(0, count) }, (_, i) => this.#block(first + i)));
    const at = from - first * BLOCK_BYTES;
    if (blocks.length === 1) return blocks[0]!.subarray(at, at + last - from);
    const joined = new Uint8Array(Math.max(0, last - from));
    blocks.forEach((block, i) => joined.set(i === 0 ? block.subarray(at) : block.subarray(0, joined.length - (i * BLOCK_BYTES - at)), i === 0 ? 0 : i * BLOCK_BYTES - at));
    return joined;
  }
  async #block(index: number): Promise<Uint8Array> {
    const kept = this.#blocks.get(index) ?? this.#source.read(index * BLOCK_BYTES, Math.min((index + 1) * BLOCK_BYTES, this.#source.size));
    this.#blocks.delete(index);
    this.#blocks.set(index, kept);
    if (this.#blocks.size > MAX_BLOCKS) this.#blocks.delete(this.#blocks.keys().next().value!);
    try {
      return await kept;
    } catch (error) {
      this.#blocks.delete(index);
      throw error;
    }
  }
}

function viewOf(bytes: Uint8Array): DataView {
  return new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
}
/** Beyond 2^53 it is no offset and no time of a file. */
function numberAt(bytes: Uint8Array, offset: number): number {
  return Number(viewOf(bytes).getBigUint64(offset, true));
}
