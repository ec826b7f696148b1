// SPDX-License-Identifier: MIT
//
// Play-out and levels through their exports: what tests/unit/motion and tests/unit/client assert of the native ones holds here.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { internals, levelsWasm, makeCore } from './support.mjs';

const { FULL, Levels, Playout } = internals;
const core = await makeCore(), control = await internals.Core.make(levelsWasm);

/** A playout with poses t = 0, 100, ... ms of the value t / 100, each 20 ms later here. */
function fed(settings, poses) {
  const playout = new Playout(core, settings);
  for (let i = 0; i < poses; ++i) assert.ok(playout.add(BigInt(100_000 * i), BigInt(100_000 * i + 20_000), [i], 0xff, false));
  return playout;
}

test('NothingIsShownBeforeTheFirstPose', () => {
  const playout = new Playout(core);
  assert.equal(playout.at(5n), undefined);
  playout.free();
});

test('TheLatestPoseIsShownAsItIs', () => {
  const playout = fed({ mode: 'latest' }, 3);
  const { timeUs, coefficients, shown } = playout.at(221_000n);
  assert.deepEqual([timeUs, Array.from(coefficients), shown], [200_000n, [2], 'live']);
  assert.equal(playout.at(1_000_000n).shown, 'held');
  playout.free();
});

test('PosesAreInterpolatedBehindTheNewest', () => {
  const playout = fed({ mode: 'interpolate', delayUs: 100_000 }, 5);
  const { coefficients, shown, timeUs } = playout.at(420_000n - 50_000n);
  assert.equal(shown, 'interpolated');
  assert.ok(Math.abs(coefficients[0] - Number(timeUs) / 100_000) < 1e-9);
  playout.free();
});

test('EstimatesGoBeyondTheNewestForALimitedTime', () => {
  const playout = fed({ mode: 'estimate' }, 4);
  playout.at(330_000n);
  const soon = playout.at(370_000n);
  assert.equal(soon.shown, 'estimated');
  assert.ok(soon.coefficients[0] > 3);
  assert.equal(playout.at(5_000_000n).shown, 'held');
  playout.free();
});

test('PosesNotAfterTheNewestAreDropped', () => {
  const playout = fed({ mode: 'latest' }, 2);
  assert.equal(playout.add(50_000n, 130_000n, [9], 0xff, false), false);
  playout.reset();
  assert.equal(playout.at(200_000n), undefined);
  playout.free();
});

test('PosesGoOnWhereTheirStreamHasLearntColumns', () => {
  const playout = fed({ mode: 'interpolate', delayUs: 100_000 }, 4);
  assert.equal(playout.at(400_000n).coefficients.length, 1);
  assert.ok(playout.add(400_000n, 420_000n, [4, 8], 0xff, false));
  const { coefficients, shown, timeUs } = playout.at(470_000n);
  assert.deepEqual([shown, timeUs, coefficients.length], ['interpolated', 350_000n, 2]);
  assert.ok(Math.abs(coefficients[0] - 3.5) < 0.05 && coefficients[1] > 2 && coefficients[1] < 6, `${coefficients}`);
  assert.ok(playout.add(500_000n, 520_000n, [5], 0xff, false), 'a shorter one replaces them');
  assert.deepEqual(Array.from(playout.at(620_000n).coefficients), [5]);
  playout.free();
});

test('ALagIsKeptWhateverTheSettingsSay', () => {
  const playout = fed({ mode: 'interpolate', delayUs: 500_000 }, 5), unknown = -(2n ** 63n);
  assert.equal(new Playout(core).keepLag(unknown), unknown, 'no pose has come');
  assert.equal(playout.keepLag(130_000n), 120_000n, 'the way, and an interval');
  assert.equal(playout.at(430_000n).timeUs, 300_000n);
  assert.equal(playout.delayUs, 110_000);
  playout.keepLag(unknown);
  assert.equal(playout.delayUs, 500_000);
  playout.free();
});

test('AKeySentAheadIsMovedTowardsAndPosesComeBeforeIt', () => {
  const playout = fed({ mode: 'interpolate', delayUs: 100_000 }, 3);
  playout.addNext(400_000n, [4], 0xff);
  assert.equal(playout.add(300_000n, 320_000n, [3.5], 0xff, false), true);
  const { coefficients, shown, timeUs } = playout.at(470_000n);
  assert.deepEqual([shown, timeUs], ['interpolated', 350_000n]);
  assert.ok(coefficients[0] > 3.5 && coefficients[0] < 4);
  assert.throws(() => playout.addNext(500_000n, new Float64Array(32_769), 0xff), { code: 'too-large' });
  playout.free();
});

test('SettingsAndPosesOutOfRangeAreRefused', () => {
  const playout = new Playout(core);
  assert.throws(() => playout.set({ mode: 'latest', delayUs: -1 }), { code: 'invalid-argument' });
  assert.throws(() => playout.setBandEnds([1, 2, 3, 4, 5, 6, 7, 8, 9]), { code: 'invalid-argument' });
  assert.throws(() => playout.add(0n, 0n, new Float64Array(32_769), 0xff, false), { code: 'too-large' });
  assert.equal(playout.add(2n ** 62n, -(2n ** 62n), [1], 0xff, false), true);
  playout.at(2n ** 62n);
  playout.free();
});

test('LevelsHoldTheRateAndSpendTheTimeWhereItIsSeen', () => {
  const levels = new Levels(control, 60);
  const objects = [{ distance: 1, pixels: 900, vertexCost: 1, max: 40_000, min: 400, drawn: 0 }, { distance: 9, pixels: 100, vertexCost: 1, max: 40_000, min: 400, drawn: 0 }];
  let resolved = [0, 0], seconds = 0;
  for (let picture = 0; picture < 300; ++picture) {
    resolved = levels.resolve(objects, BigInt(16_667 * picture), seconds);
    seconds = 0.002 + 5e-7 * (resolved[0] + resolved[1]);
  }
  assert.ok(seconds < 1 / 60 && seconds > 0.6 / 60, `${1000 * seconds} ms`);
  assert.ok(resolved[0] > 4 * resolved[1]);
  assert.ok(levels.state > 0.5 && levels.state < 1);
  assert.deepEqual(levels.resolve([], 0n, 0), []);
  assert.throws(() => levels.resolve([{ ...objects[0], min: 50_000 }], 0n, 0), { code: 'invalid-argument' });
  assert.throws(() => levels.resolve([{ ...objects[0], pixels: NaN }], 0n, 0), { code: 'invalid-argument' });
  // What costs a picture its time is given up, and comes back: pixels, or the shadow.
  const costs = { resolution: ({ resolution }) => 0.02 * resolution ** 2, shadow: ({ shadow }) => 0.006 + [0.014, 0.005][shadow] };
  for (const [name, cost] of Object.entries(costs)) {
    const one = new Levels(control, 60), object = { distance: 2, pixels: 500, vertexCost: 1, max: 20_000, min: 400 };
    const play = (count, slow) => {
      for (let i = 0, drawn = 20_000; i < count; ++i) {
        const seconds = slow * (cost(one.quality) + 0.004 * (drawn / 20_000));
        [drawn] = one.resolve([{ ...object, drawn }], BigInt(1e4 * i), seconds);
      }
      return one.quality;
    };
    assert.deepEqual(play(300, 0.5), FULL);
    const lowered = play(300, 1.5);
    assert.ok(name === 'shadow' ? lowered.shadow > 0 : lowered.resolution < 0.8, JSON.stringify(lowered));
    assert.deepEqual(play(3000, 0.3), FULL);
    one.free();
  }
  assert.throws(() => new Levels(control, 0), { code: 'invalid-argument' });
  levels.free();
});
