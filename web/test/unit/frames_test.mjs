// SPDX-License-Identifier: MIT
//
// Frames: the core against the golden files, which the native codec wrote, and against sdk/js/frames.mjs, which was written from
// docs/protocol.md alone.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { FrameDecoder, ProtocolError, stepSize } from '../../../sdk/js/frames.mjs';
import { goldenStreams, internals, joinOf, makeCore, sameBits, writerWasm } from './support.mjs';

const { Core, Frames, streamIdOf, Writer } = internals;
const core = await makeCore(), writing = await Core.make(writerWasm);
const EPOCH = 3;

/** A Frames that follows a golden stream. */
function following(stream) {
  const frames = new Frames(core);
  const { stream_id: id, tag } = stream.expected[0];
  frames.begin(id, tag, EPOCH, stream.format, stream.scheme);
  for (const segment of stream.memory?.segments ?? []) frames.remember(stream.memory.asset, segment);
  return frames;
}
function referenceOf(stream) {
  const reference = new FrameDecoder(stream.given);
  for (const segment of stream.memory?.segments ?? []) reference.addSegment(Buffer.from(stream.memory.asset, 'hex'), segment);
  return reference;
}

/** What a decoded frame of the reference, or an expected one, shows. */
function shownOf(frame) {
  return frame.shown ?? ((frame.flags & 1) !== 0 ? undefined : (frame.pose ?? frame.newer));
}

/** What frames of a chain show, one after the other: nothing where a join repeats the key that is shown. */
function shows() {
  let key, at, isShown = false;
  const isSame = (a, b) => a.bands === b?.bands && a.step === b.step && Array.from(a.values).every((value, i) => value === b.values[i]);
  return (frame) => {
    if (/key|join/.test(frame.kind)) {
      const own = frame.pose ?? frame.newer, isAhead = (frame.flags & 1) !== 0, now = `${frame.sequence} ${frame.captureUs ?? frame.capture_us}`;
      const isAgain = frame.kind === 'join' && !isAhead && isShown && now === at && isSame(own, key);
      [key, at, isShown] = [own, now, !isAhead];
      if (isAgain) return undefined;
    } else {
      isShown ||= frame.kind === 'step' && frame.at === frame.of;
    }
    return shownOf(frame);
  };
}

function coefficientsOf(key, codec) {
  return codec === 'quantised' ? Array.from(key.values, (q) => q * stepSize(key.step)) : Array.from(key.values);
}

for (const stream of goldenStreams()) {
  test(`${stream.name}: PosesAreThoseOfTheNativeCodec`, () => {
    const frames = following(stream), shown = shows();
    let ahead;
    stream.frames.forEach((bytes, i) => {
      const expected = stream.expected[i];
      const { head, coefficients, integers, step, error, shownUs, next } = frames.decode(bytes);
      assert.equal(error, undefined);
      assert.equal(head.kind, expected.kind);
      assert.deepEqual([head.at, head.of, head.streamId, head.epoch, head.sequence, head.captureUs],
        [expected.at, expected.of, expected.stream_id, EPOCH, BigInt(expected.sequence), BigInt(expected.capture_us)]);
      assert.equal(head.ahead, (expected.flags & 1) !== 0);
      if (head.ahead) ahead = expected;
      const pose = shown(expected);
      if (!pose) return assert.equal(coefficients, undefined);
      if (ahead) {
        const key = ahead.pose ?? ahead.newer;
        assert.deepEqual([next.captureUs, next.bands], [BigInt(ahead.capture_us), key.bands]);
        assert.ok(sameBits(next.coefficients, coefficientsOf(key, stream.format.codec)));
        assert.ok(shownUs < next.captureUs);
        ahead = undefined;
      } else {
        assert.deepEqual([next, shownUs], [undefined, head.captureUs]);
      }
      assert.equal(head.bands, pose.bands);
      if (stream.format.codec === 'quantised') {
        assert.deepEqual([step, Array.from(integers)], [pose.step, pose.values]);
      } else {
        assert.equal(integers, undefined);
      }
      assert.ok(sameBits(coefficients, coefficientsOf(pose, stream.format.codec)));
    });
    frames.free();
  });

  test(`${stream.name}: PosesAreThoseOfTheReferenceDecoder`, () => {
    const frames = following(stream);
    const reference = referenceOf(stream), shownBy = shows();
    for (const bytes of stream.frames) {
      const { coefficients } = frames.decode(bytes);
      const shown = shownBy(reference.decode(bytes));
      assert.equal(coefficients !== undefined, shown !== undefined);
      if (shown) assert.ok(sameBits(coefficients, coefficientsOf(shown, stream.format.codec)));
    }
    frames.free();
  });

  test(`${stream.name}: NoTruncationIsTaken`, () => {
    const frames = following(stream);
    stream.frames.forEach((bytes, i) => {
      const again = () => {
        frames.restart();
        for (const before of stream.frames.slice(0, i)) frames.decode(before);
      };
      for (let size = 0; size < bytes.length; ++size) {
        again();
        assert.ok(frames.decode(bytes.subarray(0, size)).error, `frame ${i}, ${size} of ${bytes.length} bytes`);
      }
      again();
      assert.ok(frames.decode(Uint8Array.of(...bytes, 0)).error, `frame ${i} with one byte more`);
    });
    frames.free();
  });

  test(`${stream.name}: DamagedFramesDecodeAsTheReferenceSays`, () => {
    const frames = following(stream);
    let state = 12345;
    const random = (below) => (state = (Math.imul(state, 1103515245) + 12345) >>> 0, Math.floor((state / 2 ** 32) * below));
    for (let round = 0; round < 300; ++round) {
      const i = random(stream.frames.length), damaged = stream.frames[i].slice();
      for (let n = 1 + random(3); n > 0; --n) damaged[random(damaged.length)] ^= 1 << random(8);
      const reference = referenceOf(stream), shownBy = shows();
      frames.restart();
      for (const before of stream.frames.slice(0, i)) {
        frames.decode(before);
        shownBy(reference.decode(before));
      }
      let frame = null;
      try {
        frame = reference.decode(damaged);
      } catch (error) {
        assert.ok(error instanceof ProtocolError);
      }
      const { coefficients } = frames.decode(damaged);
      const { stream_id: id, tag } = stream.expected[0];
      if (frame && (frame.streamId !== id || frame.tag !== tag)) {
        assert.equal(coefficients, undefined);  // The reference does not look at them.
        continue;
      }
      const shown = frame ? shownBy(frame) : undefined;
      assert.equal(coefficients !== undefined, shown !== undefined, `frame ${i}, round ${round}`);
      if (shown) assert.ok(sameBits(coefficients, coefficientsOf(shown, stream.format.codec)));
    }
    frames.free();
  });
}

test('AMemoryIsOfItsSurfaceAndEpochAndSegmentsAreChecked', () => {
  const stream = goldenStreams().find(({ memory }) => memory), { asset, segments } = stream.memory, frames = following(stream);
  const recalled = stream.expected.findIndex(({ flags }) => (flags & 4) !== 0);
  const isTaken = () => stream.frames.slice(0, recalled + 1).every((bytes) => frames.decode(bytes).error === undefined);
  assert.ok(isTaken());
  frames.forgetMemory();
  assert.ok(!isTaken(), 'it has none');
  for (let size = 5; size < segments[0].length; ++size) assert.throws(() => frames.remember(asset, segments[0].subarray(0, size)), { code: 'corrupt' }, String(size));
  assert.throws(() => frames.remember('b5'.repeat(32), segments[0]), { code: 'corrupt' });
  assert.throws(() => frames.remember(asset, Uint8Array.of(...segments[0], 0)), { code: 'corrupt' });
  assert.throws(() => frames.remember(asset, Uint8Array.from(segments[0], (byte, i) => (i === 4 ? 2 : byte))), { code: 'unsupported' });
  assert.ok(!isTaken(), 'nothing of them is there');
  for (const segment of segments) frames.remember(asset, segment);
  assert.ok(isTaken());
  const { stream_id: id, tag } = stream.expected[0];
  frames.begin(id, tag, EPOCH + 1, stream.format, stream.scheme);
  assert.ok(!isTaken(), 'another epoch has none');
  frames.free();
});

test('FramesOfAnotherTagAreCountedNotShown', () => {
  const stream = goldenStreams()[0];
  const frames = new Frames(core);
  frames.begin(stream.expected[0].stream_id, stream.expected[0].tag ^ 1, EPOCH, stream.format, stream.scheme);
  const { head, coefficients, error } = frames.decode(stream.frames[0]);
  assert.deepEqual([head, coefficients, error], [undefined, undefined, undefined]);
  assert.deepEqual(frames.counts, { keys: 0, synthetic: 0, joins: 0, rejected: 1, missed: 0 });
  frames.free();
});

test('FormatsOutOfRangeAreRefused', () => {
  const frames = new Frames(core);
  const good = { rows: 4, channels: 3, band_ends: [2, 4], codec: 'quantised', velocity_channels: 0, velocity_us: 1_000_000, scalars: [] };
  const scalar = { scale: 1 };
  frames.begin(1, 1, 1, good, 'linear');
  frames.begin(1, 1, 1, { ...good, channels: 16, scalars: new Array(13).fill(scalar) }, 'linear');
  for (const wrong of [{ rows: 0 }, { rows: 5000, band_ends: [5000] }, { channels: 17 }, { band_ends: [] }, { band_ends: [4, 2] },
    { band_ends: [1, 2, 3] }, { velocity_channels: 2 }, { velocity_us: 0 }, { band_ends: [1, 2, 3, 4, 5, 6, 7, 8, 9], rows: 9 }, { scalars: [scalar] },
    { channels: 4, scalars: [{ scale: 0 }] }, { channels: 4, scalars: [{ scale: NaN }] }, { channels: 4, scalars: new Array(17).fill(scalar) }]) {
    assert.throws(() => frames.begin(1, 1, 1, { ...good, ...wrong }, 'linear'), { code: 'invalid-argument' }, JSON.stringify(wrong));
  }
  frames.free();
});

test('ScalarsComeInTheSendersUnits', () => {
  const format = { rows: 2, channels: 5, band_ends: [2], codec: 'float64', velocity_channels: 0, velocity_us: 1, scalars: [{ scale: 4 }, { scale: 0.5 }] };
  const frames = new Frames(core);
  frames.begin(7, 5, EPOCH, format, 'linear');
  assert.deepEqual(Array.from(frames.decode(joinOf(format, 1, 1, 2)).coefficients), [2, 2, 2, 0.5, 4, 2, 2, 2, 0.5, 4]);
  frames.free();
});

test('AKeyAheadOfAllItsPosesComesWithTheFirstOfThem', () => {
  const format = { rows: 1, channels: 3, band_ends: [1], codec: 'float64', velocity_channels: 0, velocity_us: 1, scalars: [] };
  const frames = new Frames(core);
  frames.begin(7, 5, EPOCH, format, 'linear');
  const { head, coefficients, next } = frames.decode(joinOf(format, 9, 2000, 3, { ageUs: 1000, ahead: 0 }));
  assert.deepEqual([head.ahead, coefficients, next], [true, undefined, undefined]);
  const step = frames.decode(Uint8Array.of(3, 7, 5, 9, 0x12));
  assert.deepEqual([step.shownUs, step.next.captureUs, Array.from(step.next.coefficients)], [1500n, 2000n, [3, 3, 3]]);
  frames.free();
});

test('StreamIdsAreReadFromFramesAlone', () => {
  const stream = goldenStreams()[0];
  assert.equal(streamIdOf(core, stream.frames[0]), stream.expected[0].stream_id);
  assert.equal(streamIdOf(core, stream.frames[0].subarray(0, 4)), undefined);
  assert.equal(streamIdOf(core, new Uint8Array()), undefined);
});

test('FramesOfTheWriterAreReadToTheBit', () => {
  const format = { rows: 40, channels: 3, band_ends: [14, 40], codec: 'quantised', velocity_channels: 0, velocity_us: 1_000_000, scalars: [] };
  const error = 0.01, area = 4;
  const writer = new Writer(writing, format, error, area), frames = new Frames(core), reference = new FrameDecoder(format);
  writer.begin(9, 77);
  frames.begin(9, 77, EPOCH, format, 'linear');
  for (let k = 0; k < 60; ++k) {
    if (k === 30) writer.begin(9, 77);  // Again from a join.
    const pose = Float64Array.from({ length: 120 }, (_, i) => Math.sin(0.1 * k + i) / (1 + i));
    const frame = writer.frame(pose, BigInt(1000 + 33_333 * k)).slice();
    const { head, coefficients } = frames.decode(frame), read = reference.decode(frame);
    assert.equal(head.kind, k % 30 === 0 ? 'join' : 'key');
    assert.ok(sameBits(coefficients, coefficientsOf(read.pose ?? read.newer, 'quantised')));
    const rms = Math.sqrt(pose.reduce((sum, value, i) => sum + (value - coefficients[i]) ** 2, 0) / area);
    assert.ok(rms <= error, `${rms} of pose ${k}`);
  }
  for (const [coefficients, us] of [[new Float64Array(3), 9_000_000n], [new Float64Array(120).fill(NaN), 9_000_000n], [new Float64Array(120).fill(1e30), 9_000_000n], [new Float64Array(120), 5n], [new Float64Array(120), 2n ** 62n]])
    assert.throws(() => writer.frame(coefficients, us), (thrown) => ['invalid-argument', 'too-large'].includes(thrown.code), String(us));
  for (const [wrong, e, a] of [[{}, 0, 1], [{}, NaN, 1], [{}, 1, -1], [{ rows: 0 }, 1, 1]]) assert.throws(() => new Writer(writing, { ...format, ...wrong }, e, a), { code: 'invalid-argument' });
  writer.free();
  frames.free();
});
