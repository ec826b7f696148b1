// SPDX-License-Identifier: MIT
import { readFileSync, readdirSync } from 'node:fs';
import { dirname, join } from 'node:path';
import { fileURLToPath } from 'node:url';

export const ROOT = join(dirname(fileURLToPath(import.meta.url)), '../../..');
/** What was built: EIGENCAST_WEB_BUILD. */
export const BUILD = process.env.EIGENCAST_WEB_BUILD ?? join(ROOT, 'web/dist');
export const GOLDEN = join(ROOT, 'tests/golden');

export const internals = await import(join(BUILD, "internals.js"));
export const wasm = new WebAssembly.Module(readFileSync(join(BUILD, 'eigencast-core.wasm')));
export const levelsWasm = new WebAssembly.Module(readFileSync(join(BUILD, 'eigencast-levels.wasm')));
export const writerWasm = new WebAssembly.Module(readFileSync(join(BUILD, 'eigencast-writer.wasm')));
export const makeCore = () => internals.Core.make(wasm);

/** The streams of tests/golden: format, frames as bytes, what each decodes to. */
export function goldenStreams() {
  return readdirSync(GOLDEN).filter((name) => name.endsWith('.frames')).sort().map((name) => {
    const lines = readFileSync(join(GOLDEN, name), 'utf8').trimEnd().split('\n');
    const { scheme = 'linear', memory, ...format } = JSON.parse(lines[0].slice('format '.length));
    return {
      name,
      scheme,
      memory: memory && { asset: memory.asset, segments: memory.segments.map((hex) => new Uint8Array(Buffer.from(hex, 'hex'))) },
      given: { ...format, scheme },
      format: { channels: 3, velocity_channels: 0, velocity_us: 1_000_000, scalars: [], ...format },
      frames: lines.slice(1).map((line) => new Uint8Array(Buffer.from(line, 'hex'))),
      expected: readFileSync(join(GOLDEN, name.replace('.frames', '.jsonl')), 'utf8').trimEnd().split('\n').map((line) => JSON.parse(line)),
    };
  });
}

const varint = (value) => {
  const bytes = [];
  for (let rest = BigInt(value); ; rest >>= 7n) {
    if (rest < 128n) return Buffer.of(...bytes, Number(rest));
    bytes.push(Number(rest & 127n) | 128);
  }
};
/** A join of float64 poses (docs/protocol.md, sections 4 and 7), both of `value` everywhere. `ahead`: the byte of its step. */
export function joinOf({ channels, band_ends: ends }, sequence, captureUs, value, { streamId = 7, tag = 5, ageUs = 0, ahead } = {}) {
  const bands = (1 << ends.length) - 1;
  const sections = ends.flatMap((end, b) => {
    const run = Buffer.from(new Float64Array(2 * channels * (end - (ends[b - 1] ?? 0))).fill(value).buffer);
    return [varint(run.length), run];
  });
  return Buffer.concat([Buffer.of(ahead === undefined ? 2 : 10), varint(streamId), Buffer.of(tag, ...(ahead === undefined ? [] : [ahead]), bands),
    varint(sequence), varint(captureUs), varint(ageUs), Buffer.of(0, 0, 0, bands), ...sections]);
}

/** An asset as in tests/golden/asset: manifest, its id, chunks. */
export function assetIn(folder) {
  const bytes = (name) => new Uint8Array(readFileSync(join(folder, name)));
  const chunks = readdirSync(folder).filter((name) => /^chunk\d+\.bin$/.test(name));
  return { manifest: bytes('manifest.bin'), chunks: chunks.map((_, i) => bytes(`chunk${i}.bin`)) };
}

/** Doubles that are equal to the bit. */
export function sameBits(a, b) {
  return a.length === b.length && Array.from(a).every((value, i) => Object.is(value, b[i]));
}

/** Where a manifest's hashes and sizes are (docs/asset-format.md), for those who forge them. */
export function manifestLayout(manifest) {
  const view = new DataView(manifest.buffer, manifest.byteOffset, manifest.byteLength);
  let at = 12;
  const take = (bytes) => (at += bytes) - bytes;
  const u8 = () => view.getUint8(take(1)), u16 = () => view.getUint16(take(2), true), u32 = () => view.getUint32(take(4), true);
  const [n, r, q, F, E] = [u32(), u32(), u32(), u32(), u32()];
  const bands = u8();
  take(4 * bands + 2 + 8 * 11);
  take(u8());
  take(u8());
  take(u16());
  take(24 * r + 4 * (r - E));
  take(12 * u8());
  const chunks = Array.from({ length: u32() }, () => {
    const entry = { at: take(8), idAt: take(32) };
    return { ...entry, tiles: Array.from({ length: u8() }, () => ({ at: take(3), bytesAt: take(4), hashAt: take(32) })) };
  });
  const bytes = (tile) => view.getUint32(tile.bytesAt, true);
  return { n, r, q, F, E, bands, chunks, bytes };
}

/** The asset with hashes that fit what its chunks hold now: an enemy computes hashes, too. */
export function rehashed(core, { manifest, chunks }) {
  const forged = manifest.slice();
  const layout = manifestLayout(forged);
  layout.chunks.forEach((chunk, c) => {
    let at = 0;
    for (const tile of chunk.tiles) {
      forged.set(Buffer.from(core.sha256(chunks[c].subarray(at, at + layout.bytes(tile))), 'hex'), tile.hashAt);
      at += layout.bytes(tile);
    }
    forged.set(Buffer.from(core.sha256(chunks[c]), 'hex'), chunk.idAt);
  });
  return { manifest: forged, chunks };
}

export const ASSETS = ['asset', 'asset_smooth'].map((name) => ({
  name, ...assetIn(join(GOLDEN, name)), golden: JSON.parse(readFileSync(join(GOLDEN, name, 'golden.json'), 'utf8')),
}));

/** Numbers from 0 up to `below`, the same each time. */
export function randomNumbers(seed) {
  let state = seed;
  return (below) => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return Math.floor((state / 2 ** 32) * below);
  };
}
