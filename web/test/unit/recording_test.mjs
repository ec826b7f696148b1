// SPDX-License-Identifier: MIT
import assert from 'node:assert/strict';
import { createServer } from 'node:http';
import { test } from 'node:test';
import { ASSETS, internals, joinOf, makeCore, randomNumbers } from './support.mjs';

const { crc32c, EigencastError, Player, RecordedSession, RecordingReader, sourceOf, textFromUs, TYPES } = internals;

const number = (value) => {
  const bytes = Buffer.alloc(8);
  bytes.writeBigUInt64LE(BigInt(value));
  return bytes;
};
/** A recording's bytes, as docs/recording-format.md has them. */
class Writer {
  #parts = [Buffer.from('ECRECOR\n\x02\0\0\0', 'latin1')];
  #entries = [];
  #announce = 0;
  size = 12;

  constructor() {
    const text = (value) => Buffer.concat([Buffer.of(value.length), Buffer.from(value)]);
    this.add('start', 0, number(1_700_000_000_000_000), text('lab/horse'), text('test'));
  }
  add(type, timeUs, ...body) {
    const at = this.size, whole = Buffer.concat(body), head = Buffer.alloc(17);
    head.writeUInt32LE(whole.length, 0);
    head.writeUInt8(TYPES.indexOf(type), 4);
    head.writeBigUInt64LE(BigInt(timeUs), 5);
    head.writeUInt32LE(crc32c(head.subarray(0, 13), whole), 13);
    this.#parts.push(head, whole);
    this.size += 17 + whole.length;
    if (type === 'announce') this.#announce = at;
    if (type === 'checkpoint') this.#entries.push([timeUs, at, this.#announce]);
    return this;
  }
  end(timeUs) {
    const index = this.size;
    this.add('index', timeUs, number(0), ...this.#entries.flat().map(number));
    this.add('end', timeUs, number(index), number(1), number(0));
    return this.bytes;
  }
  get bytes() {
    return new Uint8Array(Buffer.concat(this.#parts));
  }
}
const { manifest, chunks } = ASSETS[0];
const core = await makeCore();
const asset = core.sha256(manifest);
const { rank, bandEnds } = (() => {
  const reader = new internals.AssetReader(core, asset, manifest), facts = reader.facts;
  reader.free();
  return facts;
})();
const format = { rows: rank, channels: 3, band_ends: bandEnds, codec: 'float64' };
const announcement = Buffer.from(JSON.stringify({ op: 'announce', asset, format, key_rate_hz: 10, utc_us: 7_000_000 }));

/** Ten poses a second, pose f with f everywhere, from `begins` on the sender's clock; a checkpoint a second. Of it two senders. */
function recording(seconds = 3, { holds = true } = {}) {
  const writer = new Writer();
  if (holds) for (const object of [...chunks, manifest]) writer.add('object', 0, Buffer.from(core.sha256(object), 'hex'), object);
  for (let f = 0; f < 10 * seconds; ++f) {
    if (f === 0 || f === 15) writer.add('announce', 100_000 * f, announcement);
    const join = joinOf(format, f, 7_000_000 + 100_000 * f, f, { streamId: 0, tag: 0 });
    // It arrives late by up to 20 ms.
    writer.add(f % 10 === 0 || f === 15 ? 'checkpoint' : 'frame', 100_000 * f + (f % 10 === 0 ? 0 : (7919 * f) % 20_000), join);
  }
  return writer;
}
const sourceOfBytes = (bytes, read = []) => ({
  size: bytes.length,
  read: async (from, end) => (read.push([from, end]), bytes.slice(from, end)),
});

test('RecordingsAreEnteredByTheirIndex', async () => {
  const bytes = recording().end(2_900_000), reader = await RecordingReader.open(sourceOfBytes(bytes));
  assert.equal(reader.stream, 'lab/horse');
  assert.equal(reader.startedMs, 1_700_000_000_000);
  assert.equal(reader.durationUs, 2_900_000);
  assert.deepEqual(reader.entries.map(({ timeUs }) => Math.floor(timeUs / 100_000)), [0, 10, 15, 20]);
  assert.equal(reader.entryAt(-5).timeUs, 0);
  assert.equal(reader.entryAt(1_999_999).timeUs, reader.entries[2].timeUs);
  assert.equal((await reader.at(reader.entryAt(2_500_000).checkpoint)).type, 'checkpoint');
  assert.deepEqual(Buffer.from(await reader.object(asset)), Buffer.from(manifest));
  assert.equal(await reader.object('0'.repeat(64)), undefined);
});

test('OfALongRecordingLittleIsRead', async () => {
  const writer = recording(), read = [];
  for (let i = 0; i < 50; ++i) writer.add('frame', 3_000_000, Buffer.alloc(200_000));
  const bytes = writer.end(3_000_000), reader = await RecordingReader.open(sourceOfBytes(bytes, read));
  await reader.at(reader.entryAt(0).checkpoint);
  await reader.object(asset);
  assert.ok(read.reduce((sum, [from, end]) => sum + end - from, 0) < 1_000_000, `of ${bytes.length} bytes ${JSON.stringify(read)}`);
});

test('ATornRecordingIsReadToItsLastWholeRecord', async () => {
  const whole = recording().bytes, reader = await RecordingReader.open(sourceOfBytes(whole.slice(0, -3)));
  assert.equal(reader.entries.length, 4);
  assert.equal(reader.durationUs, 2_800_000 + (7919 * 28) % 20_000);
  const damaged = whole.slice();
  damaged[reader.entries[1].checkpoint + 30] ^= 1;
  assert.equal((await RecordingReader.open(sourceOfBytes(damaged))).entries.length, 1);
});

test('HostileRecordingsAreRefusedInWords', async () => {
  const good = recording().end(2_900_000), random = randomNumbers(5);
  for (const bytes of [new Uint8Array(), good.slice(0, 30), Buffer.from('not a recording, but a text of some length')])
    await assert.rejects(RecordingReader.open(sourceOfBytes(bytes)), EigencastError);
  for (let i = 0; i < 400; ++i) {
    const bytes = good.slice(0, i % 3 === 0 ? random(good.length) : good.length);
    // Mostly of the index and the end.
    for (let k = 0; k < 3; ++k) bytes[Math.max(0, i % 2 === 0 ? random(bytes.length) : bytes.length - 1 - random(200))] = random(256);
    try {
      const reader = await RecordingReader.open(sourceOfBytes(bytes));
      for (const { announce, checkpoint } of reader.entries) await Promise.all([reader.at(announce), reader.at(checkpoint)]);
      await reader.object(asset);
    } catch (error) {
      assert.ok(error instanceof EigencastError, error.stack);
    }
  }
});

test('FilesComeByRangeOrAsAWhole', async () => {
  const bytes = recording().end(2_900_000), asked = [];
  const server = createServer((request, response) => {
    const [, from, end] = /^bytes=(\d+)-(\d+)$/.exec(request.headers.range);
    asked.push(request.url);
    if (request.url === '/none') return response.writeHead(404).end();
    if (request.url === '/whole') return response.writeHead(200, { 'content-length': bytes.length }).end(bytes);
    const part = bytes.slice(Number(from), Number(end) + 1);
    response.writeHead(206, { 'content-range': `bytes ${from}-${Number(from) + part.length - 1}/${bytes.length}` }).end(part);
  });
  await new Promise((resolve) => server.listen(0, '127.0.0.1', resolve));
  const base = `http://127.0.0.1:${server.address().port}`, at = (path) => base + path;
  try {
    for (const path of ['/ranged', '/whole']) {
      const reader = await RecordingReader.open(await sourceOf(at(path)));
      assert.equal(reader.entries.length, 4);
      assert.deepEqual(Buffer.from(await reader.object(asset)), Buffer.from(manifest));
    }
    assert.equal(asked.filter((path) => path === '/whole').length, 1);
    await assert.rejects(sourceOf(at('/none')), ({ code }) => code === 'not-found');
    assert.equal((await RecordingReader.open(await sourceOf(new Blob([bytes])))).durationUs, 2_900_000);
  } finally {
    server.close();
    server.closeAllConnections();
  }
  await assert.rejects(sourceOf(at('/gone')), ({ code }) => code === 'unreachable');
});

/** A worker's session over a recording: what it says, and a call that awaits poses. */
async function played(bytes) {
  const said = [], session = new RecordedSession(core, { nowUs: () => 0, random: () => 0.5 }, await RecordingReader.open(sourceOfBytes(bytes)), (message) => said.push(message));
  session.receive({ op: 'watch', key: 1, stream: 'lab/horse', profile: {}, maxBytes: 2 ** 28 });
  return {
    said,
    read: async (fromUs, untilUs, seek = 1) => {
      const before = said.length, told = [];
      await session.stream.read({ fromUs, untilUs, seek }, (what) => told.push(what));
      return { isDone: told.at(-1) === 'read', isSought: told[0] === 'sought', poses: said.slice(before).filter(({ op }) => op === 'pose').map(({ pose }) => [pose.coefficients[0], Number(pose.captureUs)]) };
    },
    end: () => session.receive({ op: 'end' }),
  };
}

test('PosesOfAnyTimeComeAsTheirSenderHadThem', async () => {
  const { said, read, end } = await played(recording().end(2_900_000));
  const first = await read(0, 1_000_000);
  assert.ok(first.isDone);
  assert.deepEqual(first.poses, Array.from({ length: 11 }, (_, f) => [f, 100_000 * f]), 'without the jitter of their arrival');
  assert.ok(first.isSought);
  const on = await read(1_000_000, 1_400_000);
  assert.deepEqual(on.poses.map(([f]) => f), [11, 12, 13, 14], 'on from there');
  assert.ok(!on.isSought);
  assert.deepEqual((await read(1_100_000, 1_200_000, 2)).poses.map(([f]) => f), [10, 11, 12], 'once more, for who has kept nothing');
  await read(1_200_000, 1_400_000, 2);
  assert.deepEqual((await read(2_450_000, 2_600_000)).poses.map(([f]) => f), [20, 21, 22, 23, 24, 25, 26], 'from the checkpoint before');
  assert.deepEqual((await read(1_600_000, 1_700_000)).poses.map(([f]) => f), [15, 16, 17], 'behind another announcement');
  assert.deepEqual((await read(100_000, 200_000)).poses.map(([f]) => f), [0, 1, 2]);
  assert.ok((await read(2_800_000, 9_000_000)).isDone, 'beyond its end');
  const infos = said.filter(({ op }) => op === 'info').map(({ info }) => info);
  assert.deepEqual([...new Set(infos.map(({ epoch }) => epoch))], [1], 'the surface stayed the same');
  const timecodes = new Map();
  let utcUs;
  for (const { op, info, pose } of said) {
    if (op === 'info') utcUs = info.utc_us;
    if (op === 'pose') timecodes.set(pose.coefficients[0], (timecodes.get(pose.coefficients[0]) ?? new Set()).add(pose.captureUs + utcUs));
  }
  const [[, [begunUs]]] = timecodes;
  for (const [f, times] of timecodes) assert.deepEqual([...times], [begunUs + BigInt(100_000 * f)], `of pose ${f}, from wherever it is read`);
  const { surface } = said.filter(({ op }) => op === 'surface').at(-1);
  assert.equal(surface.asset, asset);
  end();
});

test('WithoutItsSurfaceItSaysWhatHelps', async () => {
  const { said, read, end } = await played(recording(1, { holds: false }).end(900_000));
  assert.ok(!(await read(0, 500_000)).isDone);
  const { status } = said.filter(({ op }) => op === 'status').at(-1);
  assert.equal(status.state, 'refused');
  assert.match(status.detail, /include_asset/);
  end();
});

/** A player, whose poses have their time in tenths of seconds everywhere, and what it asked for. */
function player(seconds = 10) {
  const asked = [], made = new Player(1e6 * seconds, (...read) => asked.push(read));
  const give = () => {
    for (const [fromUs, untilUs, seek] of asked.splice(0)) {
      made.sought(seek);
      for (let f = Math.floor(fromUs / 100_000); 100_000 * f <= Math.min(untilUs, made.durationUs); ++f) made.add(BigInt(100_000 * f), 0n, [f], 255, false);
      made.done(untilUs);
    }
  };
  let now = 1_000_000;
  made.at(BigInt(now));
  const at = (laterUs) => {
    for (let left = laterUs; left > 0; left -= 50_000) made.at(BigInt((now += Math.min(left, 50_000)))), give();
    return made.at(BigInt(now));
  };
  return { made, at, give, asked };
}
const near = (a, b) => assert.ok(Math.abs(a - b) < 1e-6, `${a}, not ${b}`);

test('APlayerInterpolatesAtItsPosition', () => {
  const { made, at, give } = player();
  assert.equal(at(0), undefined, 'nothing has come');
  give();
  near(at(0).coefficients[0], 0);
  const shown = at(250_000);
  near(shown.coefficients[0], 2.5);
  assert.equal(shown.shown, 'interpolated');
  made.speed = 4;
  near(at(500_000).coefficients[0], 22.5);
  made.isPlaying = false;
  near(at(500_000).coefficients[0], 22.5);
  made.step(1);
  near(at(0).coefficients[0], 23);
  made.step(-1), made.step(-1);
  near(at(0).coefficients[0], 21);
});

test('APlayerWaitsForWhatIsSought', () => {
  const { made, at, give } = player();
  give();
  near(at(100_000).coefficients[0], 1);
  made.seek(7_040_000);
  made.at(2_000_000n);
  near(made.at(2_000_000n).coefficients[0], 1);
  give();
  near(made.at(2_000_000n).coefficients[0], 70.4);
  made.seek(99e6);
  give();
  near(at(0).coefficients[0], 100);
  assert.equal(made.positionUs, 10e6);
});

test('PosesFromBeforeASeekAreNotOfIt', () => {
  const { made, give, asked } = player();
  give();
  made.seek(9_000_000);
  const late = asked.splice(0);
  made.isPlaying = false;
  made.seek(0);
  made.sought(late[0][2]);
  assert.equal(made.add(9_000_000n, 0n, [90], 255, false), false);
  made.done(10e6);
  give();
  near(made.at(2_000_000n).coefficients[0], 0);
  assert.equal(made.positionUs, 0);
});

test('APlayerLoopsOrHoldsItsLastPose', () => {
  const { made, at, give } = player(1);
  give();
  near(at(1_200_000).coefficients[0], 2);
  made.isLooping = false;
  near(at(2_000_000).coefficients[0], 10);
  assert.equal(made.isPlaying, false);
  made.isPlaying = true;
  assert.equal(made.positionUs, 0);
});

test('NothingIsInterpolatedOverAGap', () => {
  let asked;
  const made = new Player(60e6, (_from, _until, seek) => (asked = seek));
  made.sought(asked);
  made.add(0n, 0n, [0], 255, false);
  made.add(20_000_000n, 0n, [1], 255, false);
  made.done(30e6);
  made.seek(10e6);
  assert.deepEqual([made.at(1n).coefficients[0], made.at(1n).shown], [0, 'held']);
});

test('TimesAreShownInMinutes', () => {
  for (const [us, text] of [[0, '0:00.0'], [61_250_000, '1:01.2'], [3_723_900_000, '1:02:03.9']]) assert.equal(textFromUs(us), text);
});
