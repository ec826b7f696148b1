// SPDX-License-Identifier: MIT
//
// Assets: the golden ones, whose entries the native reader wrote down; truncations; bytes of an enemy who computes hashes.
import assert from 'node:assert/strict';
import { createHash } from 'node:crypto';
import { readFileSync, readdirSync } from 'node:fs';
import { join } from 'node:path';
import { test } from 'node:test';
import { ASSETS, ROOT, internals, makeCore, manifestLayout, randomNumbers, rehashed } from './support.mjs';

const { AssetReader, Surface } = internals;
const core = await makeCore();

function opened({ manifest, chunks }, options) {
  const reader = new AssetReader(core, core.sha256(manifest), manifest, options);
  for (const chunk of chunks) reader.add(chunk);
  return reader;
}

/** Positions of a pose, in double, and the sum of its terms' magnitudes. */
function productInDouble(basis, C, i, d) {
  let sum = 0, magnitude = 0;
  basis[i].forEach((entry, k) => {
    sum += entry * C[3 * k + d];
    magnitude += Math.abs(entry * C[3 * k + d]);
  });
  return [sum, magnitude];
}

/** The triangles of level N, from the arrays alone. */
function trianglesAt({ faces, death, map }, N) {
  return faces.filter((_, f) => N > death[f]).map((face) => face.map((corner) => {
    while (corner >= N) corner = map[corner];
    return corner;
  })).flat();
}

test('Sha256IsThatOfNode', () => {
  const random = randomNumbers(1);
  for (const size of [0, 1, 31, 55, 56, 57, 63, 64, 65, 119, 120, 127, 128, 1000, 100_003]) {
    const bytes = Uint8Array.from({ length: size }, () => random(256));
    assert.equal(core.sha256(bytes), createHash('sha256').update(bytes).digest('hex'), `${size} bytes`);
  }
});

for (const asset of ASSETS) {
  const golden = asset.golden;

  test(`${asset.name}: PointsAreThoseOfTheWholeSurfaceAtEveryLevel`, () => {
    const reader = opened(asset), surface = new Surface(core), C = Float64Array.from(reader.rest, (value, i) => value + 0.1 * Math.sin(i));
    surface.update(reader);
    const n = golden.n, sources = Uint32Array.from({ length: n }, (_, row) => core.exports.asset_source(reader.at, row, 0));
    assert.deepEqual([...sources].sort((a, b) => a - b), Array.from({ length: n }, (_, i) => i), 'a permutation');
    assert.equal(core.exports.asset_source(reader.at, n, 0), -1, 'none such');
    const whole = surface.rebuild(reader, C, 3).positions.slice();
    surface.rebuild(reader, C, 3, golden.q);
    const points = surface.points(reader, C, 3, Uint32Array.of(sources[n - 1], n + 7, sources[0]));
    for (let i = 0; i < 3; ++i) {
      assert.ok(Math.abs(points[i] - whole[3 * (n - 1) + i]) < 1e-5 && Math.abs(points[6 + i] - whole[i]) < 1e-5);
      assert.ok(Number.isNaN(points[3 + i]));
    }
    assert.equal(surface.rebuild(reader, C, 3, golden.q).level, golden.q);
    surface.free();
    reader.free();
  });

  test(`${asset.name}: FactsAreThoseOfTheNativeReader`, () => {
    const reader = opened(asset);
    assert.equal(core.sha256(asset.manifest), golden.id);
    const facts = reader.facts;
    assert.deepEqual(
      [facts.vertexCount, facts.rank, facts.baseCount, facts.faceTotal, facts.rowsReady, facts.facesReady, facts.bandEnds, facts.name, facts.upAxis,
        facts.isLeftHanded, facts.metresPerUnit, facts.boxLow, facts.boxHigh, facts.origin, Array.from(reader.rest)],
      [golden.n, golden.r, golden.q, golden.F, golden.n, golden.F, golden.band_ends, golden.name, golden.up_axis, golden.handedness === 'left',
        golden.metres_per_unit, golden.box_low, golden.box_high, golden.origin, golden.rest]);
    reader.free();
  });

  test(`${asset.name}: PositionsAreWithin2e-6OfTheirTerms`, () => {
    const reader = opened(asset), surface = new Surface(core);
    surface.update(reader);
    const random = randomNumbers(7);
    for (let pose = 0; pose < 4; ++pose) {
      const C = Float64Array.from({ length: 3 * golden.r }, () => random(2 ** 20) / 2 ** 19 - 1);
      for (const N of [golden.q, golden.n, Math.floor((golden.n + golden.q) / 2)]) {
        const { positions, triangles, vertices } = surface.rebuild(reader, C, 3, N);
        assert.equal(vertices, N);
        assert.deepEqual(Array.from(triangles), trianglesAt(golden, N));
        for (let i = 0; i < 3 * N; ++i) {
          const [x, magnitude] = productInDouble(golden.basis, C, Math.floor(i / 3), i % 3);
          assert.ok(Math.abs(positions[i] - x) <= 2e-6 * magnitude, `pose ${pose}, level ${N}, coordinate ${i}: ${positions[i]} for ${x}`);
        }
      }
    }
    surface.free();
    reader.free();
  });

  test(`${asset.name}: NormalsAreWithinATenthOfADegree`, () => {
    const reader = opened(asset), surface = new Surface(core);
    surface.update(reader);
    const { positions, normals, triangles } = surface.rebuild(reader, reader.rest, 3);
    const sums = new Float64Array(positions.length);
    for (let t = 0; t < triangles.length; t += 3) {
      const [a, b, c] = [0, 1, 2].map((k) => [0, 1, 2].map((d) => positions[3 * triangles[t + k] + d]));
      const u = b.map((x, d) => x - a[d]), v = c.map((x, d) => x - a[d]);
      const normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
      for (let k = 0; k < 3; ++k) normal.forEach((x, d) => (sums[3 * triangles[t + k] + d] += x));
    }
    for (let i = 0; i < sums.length; i += 3) {
      const length = Math.hypot(sums[i], sums[i + 1], sums[i + 2]);
      const cosine = (sums[i] * normals[i] + sums[i + 1] * normals[i + 1] + sums[i + 2] * normals[i + 2]) / length;
      assert.ok(length > 0 && Math.acos(Math.min(cosine, 1)) < (0.1 * Math.PI) / 180, `vertex ${i / 3}`);
    }
    surface.free();
    reader.free();
  });

  test(`${asset.name}: EachChunkIsASmallerSurface`, () => {
    const reader = new AssetReader(core, core.sha256(asset.manifest), asset.manifest), surface = new Surface(core);
    for (const chunk of asset.chunks) {
      reader.add(chunk);
      surface.update(reader);
      const { vertices, triangles, normals } = surface.rebuild(reader, reader.rest, 3);
      assert.equal(vertices, reader.facts.rowsReady);
      assert.deepEqual(Array.from(triangles), trianglesAt(golden, vertices));
      for (let i = 0; i < vertices; ++i) assert.ok(Math.abs(Math.hypot(...normals.subarray(3 * i, 3 * i + 3)) - 1) < 1e-5);
    }
    assert.ok(reader.isComplete);
    surface.free();
    reader.free();
  });

  test(`${asset.name}: NoTruncationIsTaken`, () => {
    for (let size = 0; size < asset.manifest.length; ++size) {
      const part = asset.manifest.subarray(0, size);
      assert.throws(() => new AssetReader(core, core.sha256(part), part), { code: /corrupt|incompatible-version/ }, `${size} bytes`);
    }
    const reader = new AssetReader(core, golden.id, asset.manifest);
    asset.chunks.forEach((chunk) => {
      for (let size = 0; size < chunk.length; ++size) assert.throws(() => reader.add(chunk.subarray(0, size)), { code: 'corrupt' });
      assert.throws(() => reader.add(Uint8Array.of(...chunk, 0)), { code: 'corrupt' });
      reader.add(chunk);
    });
    reader.free();
  });

  test(`${asset.name}: ChangedBytesAreNoticed`, () => {
    const flipped = (bytes, i) => bytes.map((byte, k) => (k === i ? byte ^ 1 : byte));
    for (let i = 0; i < asset.manifest.length; i += 7) {
      assert.throws(() => new AssetReader(core, golden.id, flipped(asset.manifest, i)), { code: 'corrupt' });
    }
    const reader = new AssetReader(core, golden.id, asset.manifest);
    for (let i = 0; i < asset.chunks[0].length; i += 7) assert.throws(() => reader.add(flipped(asset.chunks[0], i)), { code: 'corrupt' });
    reader.add(asset.chunks[0]);
    reader.free();
  });

  test(`${asset.name}: ForgedAssetsAreRefusedOrDrawable`, () => {
    const random = randomNumbers(3);
    let taken = 0;
    for (let round = 0; round < 400; ++round) {
      const forged = { manifest: asset.manifest.slice(), chunks: asset.chunks.map((chunk) => chunk.slice()) };
      for (let n = 1 + random(3); n > 0; --n) {
        const object = random(3) === 0 ? forged.manifest : forged.chunks[random(forged.chunks.length)];
        object[random(object.length)] ^= 1 << random(8);
      }
      taken += draws(forged) ? 1 : 0;
    }
    assert.ok(taken > 0 && taken < 400, `${taken} of 400 taken`);
  });
}

/** Adds what can be added, and draws it at each step. False: it was refused. */
function draws(asset, bands = 0) {
  let reader, surface;
  try {
    const { manifest, chunks } = rehashed(core, asset);
    reader = new AssetReader(core, core.sha256(manifest), manifest, { bands, maxBytes: 2 ** 26 });
    surface = new Surface(core);
    for (const chunk of chunks) {
      const { neededBytes } = reader.chunk(reader.next);
      reader.add(bands === 0 ? chunk : chunk.subarray(0, neededBytes));
      surface.update(reader);
      const { baseCount, rowsReady } = reader.facts;
      for (const N of [baseCount, rowsReady, Math.floor((baseCount + rowsReady) / 2), rowsReady]) {
        const { triangles, vertices } = surface.rebuild(reader, reader.rest, 3, N);
        assert.ok(triangles.every((corner) => corner < vertices));
        surface.numbers(reader, reader.rest, true);
      }
    }
    return reader.isComplete;
  } catch (error) {
    assert.equal(error.name, error instanceof RangeError ? 'RangeError' : 'EigencastError', error.stack);
    return false;
  } finally {
    surface?.free();
    reader?.free();
  }
}

test('HostileAssetsOfTheFuzzerAreRefusedOrDrawable', () => {
  const folder = join(ROOT, 'tests/fuzz/corpus/asset');
  for (const name of readdirSync(folder)) {
    const bytes = new Uint8Array(readFileSync(join(folder, name)));
    const bands = 1 + bytes[0] % 8, size = bytes[1] + 256 * bytes[2];
    const manifest = bytes.slice(3, 3 + size), rest = bytes.slice(3 + size);
    const random = randomNumbers(11);
    for (let round = 0; round < 60; ++round) {
      const damaged = rest.slice();
      if (round > 0) for (let n = 1 + random(4); n > 0 && damaged.length > 0; --n) damaged[random(damaged.length)] = random(256);
      const layout = manifestLayout(manifest);
      let at = 0;
      const chunks = layout.chunks.map((chunk) => {
        const whole = new Uint8Array(chunk.tiles.reduce((sum, tile) => sum + layout.bytes(tile), 0));
        whole.set(damaged.subarray(at, at + whole.length));
        at += whole.length;
        return whole;
      });
      const drawn = draws({ manifest, chunks }, bands === 8 ? 0 : bands);
      if (round === 0) assert.ok(drawn, `${name}: the undamaged one is taken`);
    }
  }
});

/** Of a liar: many vertices, in a last chunk of which nobody has a byte. */
function liarsManifest(i) {
  const { manifest: honest } = ASSETS[0], manifest = honest.slice(), { r, E, chunks, bytes } = manifestLayout(honest);
  const view = new DataView(manifest.buffer), last = chunks.at(-1), tile = last.tiles.at(-1);
  const n = Math.floor(2 ** 29 / (192 + 6 * r + 6 * E)) - i;
  view.setUint32(12, n, true);
  view.setUint32(last.at, n, true);
  view.setUint32(tile.bytesAt, bytes(tile) + 2_000_000, true);
  return manifest;
}

test('PreviewsTakeNoMemoryForWhatManifestsClaim', async () => {
  const fresh = await makeCore(), readers = Array.from({ length: 24 }, (_, i) => liarsManifest(i));
  for (const manifest of readers) new AssetReader(fresh, fresh.sha256(manifest), manifest, { bands: 1 });
  assert.ok(fresh.bytesOfMemory < 2 ** 26, fresh.bytesOfMemory);
});

test('MemoryThatRunsOutIsATrap', async () => {
  const fresh = await makeCore();
  const open = (i) => {
    const manifest = liarsManifest(i);
    new AssetReader(fresh, fresh.sha256(manifest), manifest);
  };
  assert.throws(() => { for (let i = 0; i < 1000; ++i) open(i); }, WebAssembly.RuntimeError);
});

test('AssetsOverTheLimitAreRefusedBeforeTheyTakeMemory', () => {
  const before = core.bytesOfMemory;
  const manifest = ASSETS[0].manifest.slice();
  new DataView(manifest.buffer).setUint32(12, 16_000_000, true);
  assert.throws(() => new AssetReader(core, core.sha256(manifest), manifest), { code: /too-large|corrupt/ });
  assert.throws(() => new AssetReader(core, ASSETS[0].golden.id, ASSETS[0].manifest, { maxBytes: 1000 }), { code: 'too-large' });
  assert.equal(core.bytesOfMemory, before);
});

test('ASurfaceFollowsTheAssetThatItWasUpdatedWith', () => {
  const [first, second] = ASSETS.map((asset) => opened(asset));
  const surface = new Surface(core);
  surface.update(first);
  assert.throws(() => surface.rebuild(second, second.rest, 3), { code: 'invalid-argument' });
  surface.update(second);
  assert.equal(surface.rebuild(second, second.rest, 3).vertices, second.facts.vertexCount);
  assert.throws(() => surface.rebuild(second, new Float64Array(second.rest.length + 3), 3), { code: 'invalid-argument' });
  for (const one of [first, second, surface]) one.free();
});

test('NumbersOfVerticesAreLengthsOrFirstEntries', () => {
  for (const asset of ASSETS) {
    const reader = opened(asset), surface = new Surface(core), C = reader.rest.map((value, i) => value * (i % 3 === 0 ? 1.5 : 1));
    surface.update(reader);
    assert.equal(surface.numbers(reader, C, true).values.length, 0, 'nothing was rebuilt yet');
    surface.rebuild(reader, C, 3);
    const { values, range } = surface.numbers(reader, C, false), first = values.slice(), { vertexCount, hasDetail } = reader.facts;
    assert.equal(first.length, vertexCount);
    const positions = surface.rebuild(reader, C, 3).positions.slice(), lengths = surface.numbers(reader, C, true).values.slice();
    for (let v = 0; v < vertexCount && !hasDetail; ++v) {
      assert.equal(first[v], positions[3 * v]);
      assert.ok(Math.abs(lengths[v] - Math.hypot(...positions.subarray(3 * v, 3 * v + 3))) <= 1e-6 * lengths[v]);
    }
    const sorted = first.sort(), outer = Math.floor(vertexCount / 100);
    assert.deepEqual(range, [sorted[outer], sorted[vertexCount - 1 - outer]], 'without the outermost hundredths');
    surface.rebuild(reader, C, 3, reader.facts.baseCount);
    assert.equal(surface.numbers(reader, C, true).values.length, reader.facts.baseCount);
    assert.equal(surface.numbers(reader, C.map(() => NaN), true).range, undefined);
    assert.throws(() => surface.numbers(reader, new Float64Array(C.length + 3), true), { code: 'invalid-argument' });
    reader.free();
    surface.free();
  }
});

test('AbsentBandsAreFilledFromTheRestPose', () => {
  const reader = opened(ASSETS[0]);
  const { bandEnds, rank } = reader.facts;
  const C = new Float64Array(4 * rank).fill(9);
  const filled = reader.filled(C, 4, 1);
  for (let k = 0; k < rank; ++k) {
    const expected = k < bandEnds[0] ? [9, 9, 9, 9] : [...ASSETS[0].golden.rest.slice(3 * k, 3 * k + 3), 9];
    assert.deepEqual(Array.from(filled.subarray(4 * k, 4 * k + 4)), expected);
  }
  assert.throws(() => reader.filled(C, 3, 1), { code: 'invalid-argument' });
  reader.free();
});

test('VerticesComeFromTheirParentsAndGoThere', () => {
  for (const asset of ASSETS.filter(({ golden }) => golden.F > 0 && golden.n > golden.q)) {
    const reader = opened(asset), surface = new Surface(core), C = reader.rest, { n, q, map } = asset.golden, TURN_US = 16_667;
    surface.update(reader);
    const atOnce = (level) => {
      const { positions, normals } = surface.rebuild(reader, C, 3, level);
      return { positions: positions.slice(), normals: normals.slice() };
    };
    const all = atOnce(n);
    let now = 1;
    const next = (level) => surface.rebuild(reader, C, 3, level, 0, false, 1000, (now += TURN_US));
    /** Turns until level: in each of them vertices are on their way between their parents and where they are. */
    const turns = (level) => {
      for (let turn = 0; ; ++turn) {
        const { vertices, positions, isMoving } = next(level);
        for (let i = q; i < vertices; ++i) {
          const at = (from, k) => [0, 1, 2].map((d) => from[3 * k + d]), [y, parent, x] = [at(positions, i), at(positions, map[i]), at(all.positions, i)];
          const way = Math.hypot(...x.map((value, d) => value - parent[d])), gone = Math.hypot(...y.map((value, d) => value - parent[d])), left = Math.hypot(...x.map((value, d) => value - y[d]));
          assert.ok(Math.abs(gone + left - way) < 1e-5 * (1 + way), `${asset.name}, turn ${turn}, vertex ${i}`);
        }
        if (!isMoving) {
          assert.equal(vertices, level);
          return turn;
        }
        assert.equal(vertices, n, 'until it is there');
      }
    };
    assert.equal(next(q).vertices, q, 'a first picture waits for nothing');
    assert.ok(turns(n) > 3);
    const whole = next(n);
    assert.deepEqual([whole.positions.slice(), whole.normals.slice()], [all.positions, all.normals]);
    assert.ok(turns(q) > 1);
    const least = next(q).positions.slice();
    assert.deepEqual(least, atOnce(q).positions);
    surface.free();
    reader.free();
  }
});
