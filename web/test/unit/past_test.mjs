// SPDX-License-Identifier: MIT
//
// What a page does with what a broker keeps; tests/unit/client/rewind_desk_test.cpp.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { internals } from './support.mjs';

const { markUs, Rewinder, textFromBehind } = internals;
const BROKER_US = 1_800_000_000_000_000, S = 1_000_000;

/** A rewinder at times of a test's own, and a broker that keeps the last minute. */
function desk({ keeps = true } = {}) {
  const shows = { info: { stream: 'lab/horse', epoch: 1 }, live: { delayUs: 0, shownUs: undefined, surface: { epoch: 1 } } }, sent = [];
  let nowMs = 1000, presents = 0, epoch = 2 ** 31;
  const rewinder = new Rewinder(shows, (message) => sent.push(message), () => ++presents);
  const spans = [{ from_us: BROKER_US - 60 * S, to_us: BROKER_US }];
  const hear = (more = {}) => rewinder.hear(JSON.stringify({ op: 'history', stream: 'lab/horse', now_us: BROKER_US + 1000 * (nowMs - 1000), spans, ...more }), nowMs);
  if (keeps) hear();
  const made = {
    rewinder, shows, hear,
    turn: (ms = 60) => rewinder.turn((nowMs += ms)),
    seeks: () => sent.filter(({ op }) => op === 'seek'),
    asked: () => sent.filter(({ op }) => op === 'history').length,
    presents: () => presents,
    answer: (atUs) => (shows.info = { ...shows.info, epoch: ++epoch, rewind: { at_us: BigInt(atUs), capture_us: 5000n, speed: made.seeks().at(-1).speed } }),
    live: () => (shows.info = { stream: 'lab/horse', epoch: 1 }),
    nowUs: () => BROKER_US + 1000 * (nowMs - 1000),
  };
  made.turn();
  return made;
}
const ago = (d, seconds) => d.rewinder.seek((60 - seconds) * S);

test('ThePastIsSaidInTheWordsOfTheNativeClient', () => {
  for (const [us, text] of [[12_340_000, '12.3 s behind live'], [187 * S, '3:07 behind live'], [3727 * S, '1:02:07 behind live'], [-5, '0.0 s behind live']]) assert.equal(textFromBehind(us), text);
  for (const seconds of [1, 12, 13, 60, 700, 3600, 90_000]) assert.ok(seconds * S <= 12 * markUs(seconds * S) || seconds > 43_200, `${seconds}`);
});

test('WithoutAPastItSaysWhy', () => {
  const d = desk({ keeps: false });
  assert.equal(d.asked(), 1);
  assert.ok(!d.rewinder.hasPast);
  d.hear({ spans: [], code: 'refused', message: 'you may not' });
  d.rewinder.step(-1);
  assert.match(d.rewinder.trouble, /you may not.*refused/);
  d.rewinder.speed = 0.5;
  d.turn();
  assert.deepEqual(d.seeks(), []);
});

test('SeeksAreSentAtMostEveryTwentiethOfASecond', () => {
  const d = desk();
  assert.deepEqual([d.rewinder.says, d.rewinder.positionUs, d.rewinder.durationUs], ['live', 60 * S + 60_000, 60 * S + 60_000]);
  for (let i = 0; i < 5; ++i) ago(d, 30 + i), d.turn(10);
  d.turn(50);
  assert.deepEqual(d.seeks().map(({ at_us }) => at_us), [BROKER_US - 30 * S, BROKER_US - 34 * S]);
  assert.equal(d.rewinder.positionUs, 26 * S);
  d.answer(BROKER_US - 34 * S - 7);
  d.turn();
  assert.equal(d.rewinder.atUs, BROKER_US - 34 * S - 7);
  d.rewinder.speed = 0.5;
  d.turn();
  d.answer(BROKER_US - 34 * S);
  [d.shows.live.surface.epoch, d.shows.live.shownUs] = [d.shows.info.epoch, 1_005_000n];
  d.turn();
  assert.equal(d.rewinder.atUs, BROKER_US - 34 * S + S / 2);
});

test('APauseHoldsThePictureAndGoesOnFromThere', () => {
  const d = desk();
  d.rewinder.isPlaying = false;
  d.turn();
  assert.ok(d.rewinder.holds);
  assert.deepEqual(d.seeks(), []);
  const { atUs } = d.rewinder;
  d.turn(10_000);
  assert.equal(d.rewinder.atUs, atUs);
  assert.equal(d.rewinder.says, '10.0 s behind live');
  d.rewinder.isPlaying = true;
  d.turn();
  assert.ok(!d.rewinder.holds);
  assert.deepEqual(d.seeks().map(({ at_us, speed }) => [at_us, speed]), [[atUs, 1]]);
});

test('StepsWaitForOneAnother', () => {
  const d = desk();
  d.rewinder.step(-1), d.rewinder.step(-1);
  d.turn(), d.turn();
  assert.equal(d.seeks().length, 1);
  d.answer(BROKER_US - 100);
  d.turn();
  d.answer(BROKER_US - 200);
  d.rewinder.step(1);
  d.turn();
  assert.deepEqual(d.seeks().slice(1).map(({ at_us, speed, next = false }) => [at_us - BROKER_US, speed, next]), [[-101, 0, false], [-200, 0, true]]);
  assert.ok(!d.rewinder.isPlaying && !d.rewinder.holds);
});

test('ItGoesBackToLiveAndComesBackOnANewConnection', () => {
  const d = desk();
  d.rewinder.speed = 2;
  assert.equal(d.rewinder.speed, 1, 'nothing is faster than live');
  ago(d, 30), d.turn(), d.answer(BROKER_US - 30 * S), d.turn();
  d.rewinder.live();
  assert.equal(d.presents(), 1);
  d.live(), d.turn();
  assert.equal(d.rewinder.says, 'live');
  ago(d, 30), d.turn(), d.answer(BROKER_US - 30 * S), d.turn();
  d.rewinder.hear('', 0);
  d.live(), d.hear(), d.turn(), d.turn();
  assert.equal(d.seeks().length, 3, 'it asks again');
  d.answer(d.nowUs() - 2 * S), d.turn();
  d.live(), d.turn();
  assert.deepEqual([d.rewinder.says, d.seeks().length], ['live', 3], 'it has come to the end');
});

test('RefusedSeeksLeaveWhatIsShown', () => {
  const d = desk();
  ago(d, 30), d.turn();
  d.hear({ code: 'too-large', message: 'too many' });
  d.turn();
  assert.match(d.rewinder.trouble, /too many/);
  assert.equal(d.rewinder.says, 'live');
});

test('FollowersGoWhereTheyAreNot', () => {
  const lead = desk(), d = desk();
  assert.equal(lead.rewinder.led, undefined);
  ago(lead, 30), lead.turn();
  d.rewinder.follow(lead.rewinder.led), d.turn();
  d.answer(BROKER_US - 30 * S), d.turn();
  d.rewinder.follow({ atUs: BROKER_US - 30 * S + 100_000, speed: 1 }), d.turn();
  assert.equal(d.seeks().length, 1, 'it is there');
  d.rewinder.follow({ atUs: BROKER_US - 30 * S, speed: 0 }), d.turn();
  assert.deepEqual([d.seeks().length, d.rewinder.isPlaying], [2, false]);
  d.rewinder.follow(undefined);
  assert.deepEqual([d.presents(), d.rewinder.says], [1, 'live']);
});

test('HostileHistoriesAreTakenForNone', () => {
  const d = desk();
  d.rewinder.hear('{"op":"history",', 0);
  for (const spans of [null, 7, [7], [null], [{}], [{ from_us: 'x', to_us: 1 }], [{ from_us: 2, to_us: 1 }], [{ from_us: -1, to_us: 1 }], [{ from_us: 0.5, to_us: 1 }], [{ from_us: 0, to_us: 1e300 }]]) {
    d.hear({ spans });
    assert.ok(!d.rewinder.hasPast, JSON.stringify(spans));
    d.turn();
  }
});
