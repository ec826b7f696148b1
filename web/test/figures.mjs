// SPDX-License-Identifier: MIT
//
// figures.mjs OBJECTS ASSET [RUNS]: what an asset takes in the core: memory, decoding, rebuilding with normals. OBJECTS is a folder of
// objects by their hashes, as a broker's or ~/.cache/eigencast/objects; ASSET the manifest's hash. EIGENCAST_WEB_BUILD: what was built.
import { existsSync, readFileSync, readdirSync } from 'node:fs';
import { join } from 'node:path';
import { gzipSync } from 'node:zlib';
import { BUILD, internals, wasm } from './unit/support.mjs';

const { AssetReader, Core, Surface } = internals;
const [, , folder, id, runs = '9'] = process.argv;
const object = (name) => new Uint8Array(readFileSync([join(folder, name), join(folder, name.slice(0, 2), name), join(folder, name.slice(0, 2), name.slice(2))].find(existsSync)));
const median = (values) => values.sort((a, b) => a - b)[Math.floor(values.length / 2)];
/** Milliseconds of processor time, which others on the machine do not add to. */
const spent = () => {
  const { user, system } = process.cpuUsage();
  return (user + system) / 1000;
};
const timed = (work) => {
  const start = spent();
  const result = work();
  return [spent() - start, result];
};

const manifest = object(id);
const times = { manifest: [], decode: [], update: [], rebuild: [] };
let memory = 0, facts, bytes = manifest.length;
for (let run = 0; run < Number(runs); ++run) {
  const core = await Core.make(wasm);
  const [took, reader] = timed(() => new AssetReader(core, id, manifest));
  times.manifest.push(took);
  const chunks = Array.from({ length: reader.chunkCount }, (_, i) => object(reader.chunk(i).id));
  bytes = chunks.reduce((sum, chunk) => sum + chunk.length, manifest.length);
  const surface = new Surface(core);
  let decode = 0, update = 0;
  for (const chunk of chunks) {
    decode += timed(() => reader.add(chunk))[0];
    update += timed(() => surface.update(reader))[0];
  }
  times.decode.push(decode);
  times.update.push(update);
  facts = reader.facts;
  const C = reader.rest;
  for (let warm = 0; warm < 10; ++warm) surface.rebuild(reader, C, 3);
  const rebuilds = Array.from({ length: 30 }, () => timed(() => surface.rebuild(reader, C, 3))[0]);
  times.rebuild.push(median(rebuilds));
  memory = Math.max(memory, core.bytesOfMemory);
}
console.log(`${facts.name}: ${facts.vertexCount} x ${facts.rank}, ${facts.faceTotal} faces, ${(bytes / 1e6).toFixed(2)} MB`);
const lowest = new AssetReader(await Core.make(wasm), id, manifest, { bands: 1 }).chunk(0);
console.log(`first picture: manifest and ${lowest.neededBytes} of ${lowest.bytes} bytes of the first chunk, ${lowest.endRow} vertices`);
console.log(`memory of the core, at its largest: ${(memory / 1e6).toFixed(1)} MB`);
for (const [name, values] of Object.entries(times)) {
  if (values.length > 0) console.log(`${name}: ${median(values).toFixed(2)} ms (least ${Math.min(...values).toFixed(2)})`);
}
for (const name of readdirSync(BUILD).filter((one) => /\.(wasm|js)$/.test(one) && one !== 'internals.js')) {
  const content = readFileSync(join(BUILD, name));
  console.log(`${name}: ${content.length} bytes, ${gzipSync(content, { level: 9 }).length} gz`);
}
