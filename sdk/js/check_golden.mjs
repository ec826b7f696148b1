// SPDX-License-Identifier: MIT
//
// check_golden.mjs FOLDER [--undamaged]: decodes every *.frames of a folder as tests/golden is, compares with the *.jsonl beside it,
// and, by default, makes sure that no truncation or extension of a frame is taken.
import { readdirSync, readFileSync } from 'node:fs';
import { join } from 'node:path';
import { FrameDecoder, ProtocolError } from './frames.mjs';

const names = { streamId: 'stream_id', captureUs: 'capture_us', ageUs: 'age_us' };

function textOf(frame) {
  const plain = (key) => ({ bands: key.bands, step: key.step, values: Array.from(key.values) });
  const entries = Object.entries(frame).map(([name, value]) => [
    names[name] ?? name, typeof value === 'bigint' ? Number(value) : value?.values ? plain(value) : value,
  ]);
  return JSON.stringify(Object.fromEntries(entries));
}

function decoderOf({ memory, ...format }) {
  const decoder = new FrameDecoder(format), bytes = (hex) => new Uint8Array(Buffer.from(hex, 'hex'));
  for (const segment of memory?.segments ?? []) decoder.addSegment(bytes(memory.asset), bytes(segment));
  return decoder;
}

function rejects(format, before, frame) {
  const decoder = decoderOf(format);
  for (const one of before) decoder.decode(one);
  try {
    decoder.decode(frame);
    return false;
  } catch (error) {
    if (error instanceof ProtocolError) return true;
    throw error;
  }
}

const damages = process.argv[3] !== '--undamaged';
let failures = 0;
const files = readdirSync(process.argv[2]).filter((name) => name.endsWith('.frames')).sort();
for (const name of files) {
  const lines = readFileSync(join(process.argv[2], name), 'utf8').trimEnd().split('\n');
  const format = JSON.parse(lines[0].slice('format '.length));
  const frames = lines.slice(1).map((line) => new Uint8Array(Buffer.from(line, 'hex')));
  const expected = readFileSync(join(process.argv[2], name.replace('.frames', '.jsonl')), 'utf8').trimEnd().split('\n');
  const decoder = decoderOf(format);
  let same = frames.length === expected.length;
  let safe = true;
  frames.forEach((frame, index) => {
    same &&= textOf(decoder.decode(frame)) === expected[index];
    if (!damages) return;
    for (let size = 0; size < frame.length; ++size) safe &&= rejects(format, frames.slice(0, index), frame.subarray(0, size));
    safe &&= rejects(format, frames.slice(0, index), Uint8Array.of(...frame, 0));
  });
  console.log(`${name}: ${frames.length} frames, ${same ? 'as expected' : 'DIFFERENT'}, damage ${!damages ? 'not tried' : safe ? 'rejected' : 'TAKEN'}`);
  failures += same && safe ? 0 : 1;
}
process.exitCode = failures > 0 || files.length === 0 ? 1 : 0;
