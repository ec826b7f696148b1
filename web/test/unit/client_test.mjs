// SPDX-License-Identifier: MIT
//
// The client against a broker that does what a test says: messages, acknowledgements, reconnects, downloads.
import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import { afterEach, beforeEach, test } from 'node:test';
import { FakeBroker, environment, until } from './fake_broker.mjs';
import { ASSETS, GOLDEN, goldenStreams, internals, joinOf, makeCore, wasm } from './support.mjs';

const { brokerUrl, connect, Retry, readControl, streamUrl, tryAgainIn, writeControl } = internals;
const core = await makeCore();
const golden = ASSETS[0];
const RANK = golden.golden.r;
const FORMAT = { rows: RANK, channels: 3, band_ends: golden.golden.band_ends, codec: 'float64' };

let fake, broker;
beforeEach(async () => {
  fake = await new FakeBroker().start();
  fake.objects.set(golden.golden.id, golden.manifest);
  for (const chunk of golden.chunks) fake.objects.set(core.sha256(chunk), chunk);
  fake.onConnection = (connection) => fake.say({ op: 'welcome', version: '1', session_id: 'a', time_us: 1 }, connection);
  broker = await connect(fake.url, { core: wasm, worker: false, environment });
});
afterEach(async () => {
  broker.close();
  await fake.stop();
});

const live = (more = {}) => ({ op: 'stream', stream: 'lab/horse', state: 'live', stream_id: 7, epoch: 3, tag: 5, asset: golden.golden.id, format: FORMAT, ...more });

const join = (...what) => joinOf(FORMAT, ...what);

/** All statuses of a stream, in their order. */
function statusesOf(stream) {
  const all = [];
  stream.on('status', (status) => all.push(status));
  return all;
}
const said = (connection, op) => connection.received.map((text) => JSON.parse(text)).filter((message) => message.op === op);

test('OneStreamIsNamedInTheUrlOfItsConnection', async () => {
  broker.watch('lab/horse', { profile: { rate: 'raw' } });
  await until(() => fake.last);
  assert.equal(fake.last.url, '/v1/subscribe/lab/horse?rate=raw&bands=8');
  assert.equal(fake.last.protocol, 'eigencast.v2');
});

test('AStreamThatIsPausedBeforeItIsConnectedBringsNoPoses', async () => {
  const stream = broker.watch('lab/horse');
  await undefined;  // It is asked for.
  stream.pause();
  await until(() => fake.last && said(fake.last, 'unsubscribe').length === 1);
  stream.resume();
  await until(() => said(fake.last, 'subscribe').length === 1);
});

test('SeveralStreamsShareAConnection', async () => {
  const streams = ['a', 'b', 'c'].map((name) => broker.watch(name));
  await until(() => fake.last && said(fake.last, 'subscribe').length >= 2);
  const named = fake.last.url === '/v1/subscribe' ? [] : [fake.last.url.replace(/^\/v1\/subscribe\/|\?.*/g, '')];
  assert.deepEqual([...named, ...said(fake.last, 'subscribe').map((message) => message.stream)].sort(), ['a', 'b', 'c']);
  assert.equal(fake.connections.length, 1);
  streams[1].close();
  await until(() => said(fake.last, 'unsubscribe').length === 1);
  assert.equal(said(fake.last, 'unsubscribe')[0].stream, 'b');
});

test('AGroupIsNamedInEachSubscriptionAndMomentsComeToThePage', async () => {
  const texts = [], stream = broker.watch('lab/horse', { sync: 'group' });
  broker.onText.add((text) => texts.push(text));
  await until(() => fake.last && said(fake.last, 'subscribe').length === 1);
  assert.equal(fake.last.url, '/v1/subscribe', 'a URL does not say it');
  stream.setProfile({ rate: 'raw' });
  stream.pause();
  stream.resume();
  await until(() => said(fake.last, 'subscribe').length === 3);
  assert.deepEqual(said(fake.last, 'subscribe').map(({ sync }) => sync), ['group', 'group', 'group']);
  fake.say({ op: 'moment', stream: 'lab/horse', lag_us: 5 });
  broker.sendText('{"op":"late","stream":"lab/horse","lag_us":7}');
  await until(() => texts.length === 2 && said(fake.last, 'late').length === 1);
  assert.deepEqual(texts.map((text) => text && JSON.parse(text).op), ['', 'moment']);
});

test('StatesAreThoseOfTheNativeClient', async () => {
  const stream = broker.watch('lab/horse');
  const statuses = statusesOf(stream);
  await until(() => fake.last);
  fake.say({ op: 'stream', stream: 'lab/horse', state: 'waiting', stream_id: 7, epoch: 0 });
  await until(() => stream.status?.state === 'waiting');
  fake.say(live());
  await until(() => stream.surface?.isComplete);
  fake.say(live({ state: 'stalled' }));
  await until(() => stream.status.state === 'stalled');
  const words = statuses.map(({ state, detail }) => `${state}: ${detail}`);
  const where = fake.url.replace('http', 'ws');
  for (const expected of [`connecting: connecting to ${where}`, 'connecting: connected, asking for lab/horse', `waiting: waiting for a sender at ${where}/lab/horse`,
    'downloading: downloading the surface', 'live: live, downloading detail', 'live: live', `stalled: stalled: the sender of ${where}/lab/horse is gone, its last pose is held`]) {
    assert.ok(words.includes(expected), `${expected} in ${JSON.stringify(words)}`);
  }
});

test('PosesOfThePendingSurfaceWaitForIt', async () => {
  const stream = broker.watch('lab/horse');
  const { get } = fake.objects;
  await until(() => fake.last);
  fake.objects.get = () => undefined;  // 404 until then
  fake.say(live());
  fake.send(join(1, 1000, 1));
  fake.send(join(2, 2000, 2.5));
  await until(() => stream.status?.detail.includes('404'));
  assert.equal(stream.status.state, 'downloading');
  assert.equal(stream.pose, undefined);
  fake.objects.get = get;
  await until(() => stream.pose);
  assert.deepEqual([stream.pose.sequence, stream.pose.captureUs, Array.from(stream.pose.coefficients)], [2n, 2000n, new Array(3 * RANK).fill(2.5)]);
});

test('TheFirstPictureNeedsAPrefixOfTheFirstChunk', async () => {
  const surfaces = [];
  const coded = ASSETS[1];
  const stream = broker.watch('lab/horse');
  stream.on('surface', (surface) => surfaces.push(surface));
  await until(() => fake.last);
  fake.say(live());
  await until(() => stream.surface?.isComplete);
  assert.ok(coded);
  const first = core.sha256(golden.chunks[0]);
  const ofFirst = fake.requests.filter(({ id }) => id === first).map(({ range }) => range);
  if (surfaces[0].isPrefix) {
    const [, end] = /^bytes=0-(\d+)$/.exec(ofFirst[0]);
    assert.equal(ofFirst[1], `bytes=${Number(end) + 1}-`);
  } else {
    assert.deepEqual(ofFirst, [undefined]);
  }
  assert.deepEqual(surfaces.map(({ facts }) => facts.rowsReady), surfaces.map(({ facts }) => facts.rowsReady).sort((a, b) => a - b));
  assert.equal(stream.surface.facts.rowsReady, golden.golden.n);
});

test('AnExpectedSurfaceIsFetchedBeforeItIsAnnouncedAndShownNoSooner', async () => {
  const stream = broker.watch('lab/horse', { expects: golden.golden.id });
  await until(() => golden.chunks.every((chunk) => fake.requests.some(({ id }) => id === core.sha256(chunk))) && fake.last, 'the surface');
  const asked = fake.requests.length;
  assert.equal(stream.surface, undefined);
  fake.say(live());
  await until(() => stream.surface?.isComplete);
  assert.equal(fake.requests.length, asked, 'nothing is fetched twice');
  assert.equal(stream.surface.epoch, 3);
});

test('AnotherSurfaceThanTheExpectedOneIsShown', async () => {
  const stream = broker.watch('lab/horse', { expects: 'f'.repeat(64) });
  await until(() => fake.last && fake.requests.length > 0);
  fake.say(live());
  await until(() => stream.surface?.isComplete);
  assert.equal(stream.surface.asset, golden.golden.id);
  stream.close();
  const asked = fake.requests.length;
  await new Promise((resolve) => setTimeout(resolve, 700));  // Beyond the first pause of a download that failed.
  assert.equal(fake.requests.length, asked, 'what was expected is no longer asked for');
});

test('AKeySentAheadShowsTheStepBeforeItAndComesAlong', async () => {
  const stream = broker.watch('lab/horse');
  const poses = [];
  stream.on('pose', (pose) => poses.push(pose));
  await until(() => fake.last);
  fake.say(live());
  await until(() => stream.surface?.isComplete);
  fake.send(join(5, 30_000, 2, { ageUs: 30_000, ahead: 0x13 }));
  fake.send(Buffer.of(3, 7, 5, 5, 0x23));
  await until(() => poses.length === 2);
  assert.deepEqual(poses.map(({ kind, sequence, captureUs, next }) => [kind, sequence, captureUs, next?.captureUs]), [['step', 5n, 10_000n, 30_000n], ['step', 5n, 20_000n, undefined]]);
  assert.deepEqual(Array.from(poses[0].next.coefficients), new Array(3 * RANK).fill(2));
  await until(() => said(fake.last, 'ack').flatMap(({ items }) => items).some(({ sequence, step }) => sequence === 5 && step === 0x23));
});

test('BrokenDownloadsGoOnWhereTheyBroke', async () => {
  let broken = 0;
  fake.breaks = () => ++broken <= 3;
  const stream = broker.watch('lab/horse');
  await until(() => fake.last);
  fake.say(live());
  await until(() => stream.surface?.isComplete);
  assert.ok(fake.requests.some(({ id, range }) => id === golden.golden.id && /^bytes=[1-9]\d*-$/.test(range ?? '')));
});

test('ObjectsOfAnotherHashAreNotShown', async () => {
  fake.objects.set(golden.golden.id, golden.manifest.map((byte, i) => (i === 40 ? byte ^ 1 : byte)));
  const stream = broker.watch('lab/horse');
  await until(() => fake.last);
  fake.say(live());
  await until(() => stream.status?.detail.includes('hash'));
  assert.equal(stream.status.state, 'downloading');
  assert.equal(stream.surface, undefined);
});

test('PosesThatCannotDeformTheSurfaceAreRefusedWithAReason', async () => {
  const stream = broker.watch('lab/horse');
  await until(() => fake.last);
  fake.say(live({ format: { ...FORMAT, rows: RANK + 1, band_ends: [RANK + 1] } }));
  await until(() => stream.status?.state === 'refused');
  assert.match(stream.status.detail, /has 5 columns, the stream's poses have 6/);
});

test('SurfacesOverTheLimitAreRefusedWithAReason', async () => {
  const stream = broker.watch('lab/horse', { maxBytes: 100 });
  await until(() => fake.last);
  fake.say(live());
  await until(() => stream.status?.state === 'refused');
  assert.match(stream.status.detail, /memory/);
});

test('FramesAreAcknowledgedSoonAndExactly', async () => {
  const stream = broker.watch('lab/horse');
  await until(() => fake.last);
  fake.say(live());
  await until(() => stream.surface);
  const sequence = 2n ** 63n + 1n;
  fake.send(join(sequence, 5, 1));
  await until(() => said(fake.last, 'ack').length > 0);
  assert.ok(fake.last.received.some((text) => text.includes('"sequence":9223372036854775809')), 'to the last digit');
  const [{ items }] = said(fake.last, 'ack');
  assert.deepEqual(items.map(({ stream_id, step }) => [stream_id, step]), [[7, 0]]);
});

test('PingsAreAnsweredToTheLastDigit', async () => {
  broker.watch('lab/horse');
  await until(() => fake.last);
  fake.say('{"op":"ping","id":18446744073709551615,"time_us":4611686018427387903}');
  const pong = await until(() => fake.last.received.find((text) => text.includes('"pong"')));
  assert.match(pong, /"id":18446744073709551615,"time_us":4611686018427387903,"peer_time_us":\d+/);
});

test('ClockIsFoundByPings', async () => {
  const stream = broker.watch('lab/horse');
  fake.onConnection = ({ socket }) => socket.on('message', (data) => {
    const message = JSON.parse(String(data));
    if (message.op === 'ping') socket.send(JSON.stringify({ op: 'pong', id: message.id, time_us: message.time_us, peer_time_us: message.time_us + 5_000_000 }));
  });
  await until(() => fake.last);
  fake.say(live());
  await until(() => stream.status?.state === 'live');
  await until(() => {
    fake.say({ op: 'notice', message: `n${Math.random()}` });
    return stream.status.clock;
  });
  const { offsetUs, errorUs } = stream.status.clock;
  assert.ok(Math.abs(offsetUs - 5_000_000) <= errorUs + 1, `${offsetUs} within ${errorUs}`);
});

test('HostileMessagesChangeNothing', async () => {
  const stream = broker.watch('lab/horse');
  await until(() => fake.last);
  fake.say(live());
  await until(() => stream.surface?.isComplete);
  const warn = console.warn;
  console.warn = () => {};
  for (const text of ['', '{', '[]', 'null', '{"op":7}', '{"op":"constructor"}', '{"op":"__proto__"}', '{"op":"stream"}', '[[[[[[[[[[]]]]]]]]]]', `"${'x'.repeat(70_000)}"`,
    JSON.stringify(live({ stream_id: -1 })), JSON.stringify(live({ tag: 256 })), JSON.stringify(live({ tag: undefined })), JSON.stringify(live({ format: { ...FORMAT, band_ends: [5, 5] } })), JSON.stringify(live({ asset: 'zz' })),
    '{"op":"ping","id":1e3,"time_us":1}', '{"op":"ping","id":18446744073709551616,"time_us":1}', '{"op":"pong","id":1,"time_us":1,"peer_time_us":-5}']) fake.say(text);
  for (const bytes of [Buffer.alloc(0), Buffer.alloc(26), Buffer.alloc(5000, 255), join(1, 1, 1).subarray(0, 60), join(1, 1, Infinity)]) fake.send(bytes);
  fake.send(join(9, 9000, 3));
  await until(() => stream.pose?.sequence === 9n);
  console.warn = warn;
  assert.equal(stream.status.state, 'live');
  assert.equal(fake.connections.length, 1);
});

test('ALostConnectionComesBackByItself', async () => {
  const stream = broker.watch('lab/horse');
  const statuses = statusesOf(stream);
  await until(() => fake.last);
  fake.say(live());
  await until(() => stream.surface?.isComplete);
  fake.last.socket.close(1001, 'tired');
  await until(() => fake.connections.length === 2);
  fake.say(live());
  fake.send(join(4, 4000, 4));
  await until(() => stream.pose?.sequence === 4n);
  const lost = statuses.find(({ state }) => state === 'lost');
  assert.match(lost.detail, /closed the connection \(1001, tired\); next try in \d+ ms$/);
  assert.ok(lost.retryInMs > 0 && lost.retryInMs <= 6250);
  assert.equal(stream.status.reconnects, 1);
  assert.equal(fake.requests.filter(({ id }) => id === golden.golden.id).length, 1, 'the surface is kept');
});

test('ABrokerThatGaveTheStreamAwayIsNotAskedAgain', async () => {
  const stream = broker.watch('lab/horse');
  await until(() => fake.last);
  fake.last.socket.close(4409, 'taken over');
  await until(() => stream.status?.state === 'refused');
  assert.equal(stream.status.retryInMs, undefined);
  assert.equal(fake.connections.length, 1);
});

test('RefusedConnectionsSayWhyAndWhatToDo', async () => {
  fake.refusal = { status: 401, body: '{"error":"refused","message":"a token is needed"}' };
  const stream = broker.watch('lab/horse');
  await until(() => stream.status?.state === 'refused');
  assert.match(stream.status.detail, /answered 401: a token is needed \(give a token\); next try in (2[2-9]|3[0-8]) s$/);
  fake.refusal = { status: 429, body: '{"error":"refused","message":"too many"}', headers: 'Retry-After: 120\r\n' };
  broker.retryNow();
  await until(() => stream.status.detail.includes('429'));
  assert.ok(stream.status.retryInMs >= 60_000);
  fake.refusal = undefined;
  broker.retryNow();
  await until(() => fake.last);
});

test('ADeclinedStreamIsAskedForAgain', async () => {
  const stream = broker.watch('lab/horse', { declinedRetryMs: 50 });
  await until(() => fake.last);
  fake.say({ op: 'error', code: 'refused', message: 'no right', stream: 'lab/horse' });
  await until(() => stream.status?.state === 'refused');
  assert.equal(stream.status.detail, 'the broker says: no right (refused); next try in 50 ms');
  await until(() => said(fake.last, 'subscribe').length > 0);
  fake.say(live());
  await until(() => stream.status.state === 'live');
});

test('APausedStreamKeepsItsConnection', async () => {
  const stream = broker.watch('lab/horse');
  await until(() => fake.last);
  fake.say(live());
  await until(() => stream.surface?.isComplete);
  stream.pause();
  await until(() => said(fake.last, 'unsubscribe').length === 1);
  stream.resume();
  await until(() => said(fake.last, 'subscribe').length === 1);
  fake.say(live());
  fake.send(join(8, 8000, 8));
  await until(() => stream.pose?.sequence === 8n);
  assert.deepEqual([fake.connections.length, stream.status.state, stream.status.reconnects], [1, 'live', 0]);
});

test('AnotherEpochReplacesTheSurfaceOnceItCanBeDrawn', async () => {
  const other = ASSETS[1];
  const stream = broker.watch('lab/horse');
  await until(() => fake.last);
  fake.say(live());
  await until(() => stream.surface?.isComplete);
  const format = { rows: other.golden.r, channels: 3, band_ends: other.golden.band_ends, codec: 'float64' };
  fake.say(live({ epoch: 4, asset: other.golden.id, format }));
  await until(() => stream.status.detail.includes('404'));
  assert.equal(stream.surface.epoch, 3);
  fake.objects.set(other.golden.id, other.manifest);
  for (const chunk of other.chunks) fake.objects.set(core.sha256(chunk), chunk);
  await until(() => stream.surface.epoch === 4 && stream.surface.isComplete);
  assert.equal(stream.surface.facts.vertexCount, other.golden.n);
});

/** The golden asset with the columns that its stream has learnt. */
function learnt({ hasSection = true } = {}) {
  const bytes = (name) => new Uint8Array(readFileSync(`${GOLDEN}/asset/${name}`));
  const manifest = bytes('columns_manifest.bin'), section = bytes('columns.bin');
  const [id, sectionId] = [manifest, section].map((one) => core.sha256(one));
  fake.objects.set(id, manifest);
  if (hasSection) fake.objects.set(sectionId, section);
  const { r, band_ends: ends, basis } = JSON.parse(readFileSync(`${GOLDEN}/asset/columns.json`));
  return { id, section, sectionId, rank: r, basis, format: { ...FORMAT, rows: r, band_ends: ends } };
}
/** The rows of the basis that are shown, by one column at a time, are those of the native reader. */
async function checkBasis(stream, basis, rank) {
  for (let k = 0; k < rank; ++k) {
    const coefficients = new Float64Array(3 * rank);
    coefficients[3 * k] = 1;
    const { positions } = await stream.rebuild({ coefficients, channels: 3 });
    assert.deepEqual(Array.from(positions.filter((_, i) => i % 3 === 0)), basis.map((row) => row[k]), `column ${k}`);
  }
}

test('OfWhatAStreamLearntOnlyColumnsAreFetched', async () => {
  const { id, sectionId, rank, basis, format } = learnt();
  const stream = broker.watch('lab/horse');
  await until(() => fake.last);
  fake.say(live());
  await until(() => stream.surface?.isComplete);
  const fetched = fake.requests.length;
  fake.say(live({ epoch: 4, tag: 6, asset: id, format }));
  fake.send(joinOf(format, 9, 9000, 9, { tag: 6 }));
  await until(() => stream.pose?.epoch === 4);
  assert.deepEqual(fake.requests.slice(fetched).map((one) => one.id), [id, sectionId], 'and their manifest');
  assert.deepEqual([stream.surface.epoch, stream.surface.isComplete, stream.surface.facts.rank, stream.surface.continues], [4, true, rank, false]);
  assert.equal(stream.surface.asset, golden.golden.id, 'to who sees it the same');
  assert.deepEqual([stream.pose.bandEnds, Array.from(stream.pose.coefficients)], [format.band_ends, new Array(3 * rank).fill(9)]);
  await checkBasis(stream, basis, rank);
  const { positions } = await stream.rebuild({ coefficients: new Float64Array(3 * RANK).fill(1), channels: 3 });
  assert.ok(positions.every(Number.isFinite), 'a pose of before is drawn, too');
});

test('AStreamThatChangesOverLosesNoPose', async () => {
  const { id, sectionId, rank, basis, format } = learnt();
  const stream = broker.watch('lab/horse'), poses = [];
  stream.on('pose', ({ epoch, sequence, coefficients }) => poses.push([epoch, sequence, coefficients.length / 3]));
  await until(() => fake.last);
  fake.say(live());
  await until(() => stream.surface?.isComplete);
  const fetched = fake.requests.length;
  fake.say(live({ next: { asset: id } }));
  await until(() => said(fake.last, 'prepared').length === 1);
  const [{ stream: name, asset }] = said(fake.last, 'prepared');
  assert.deepEqual([name, asset], ['lab/horse', id]);
  fake.send(join(8, 8000, 8));
  fake.say(live({ epoch: 4, tag: 6, asset: id, format }));
  fake.send(joinOf(format, 9, 9000, 9, { tag: 6 }));
  fake.send(joinOf(format, 10, 10_000, 10, { tag: 6 }));
  await until(() => stream.pose?.sequence === 10n);
  assert.deepEqual(poses, [[3, 8n, RANK], [4, 9n, rank], [4, 10n, rank]]);
  assert.deepEqual([stream.surface.continues, stream.surface.facts.rank, stream.surface.asset], [true, rank, golden.golden.id]);
  assert.deepEqual(fake.requests.slice(fetched).map((one) => one.id), [id, sectionId]);
  await checkBasis(stream, basis, rank);
  fake.say(live({ epoch: 5, tag: 7, asset: id, format }));
  await until(() => stream.surface.epoch === 5);
  assert.equal(stream.surface.continues, false, 'another sender of the same surface');
});

test('ASmallPictureHoldsNoChangeOver', async () => {
  const { id, sectionId, rank, format } = learnt();
  const stream = broker.watch('lab/horse', { isPreview: true });
  await until(() => fake.last);
  fake.say(live());
  await until(() => stream.surface);
  for (let i = 0; i < 2; ++i) fake.say(live({ next: { asset: id } }));
  await until(() => said(fake.last, 'prepared').length > 0);
  fake.say(live({ epoch: 4, tag: 6, asset: id, format }));
  fake.send(joinOf(format, 9, 9000, 9, { tag: 6 }));
  await until(() => stream.pose?.epoch === 4);
  assert.deepEqual(said(fake.last, 'prepared').map(({ asset }) => asset), [id], 'once');
  assert.ok(stream.surface.facts.rank < rank && !fake.requests.some((one) => one.id === sectionId), 'without columns');
});

test('WhatIsPreparedAndDoesNotComeIsForgotten', async () => {
  const { id } = learnt();
  const stream = broker.watch('lab/horse');
  await until(() => fake.last);
  fake.say(live());
  await until(() => stream.surface?.isComplete);
  fake.say(live({ next: { asset: id } }));
  await until(() => said(fake.last, 'prepared').length === 1);
  fake.say(live({ epoch: 4, tag: 6 }));
  fake.send(joinOf(FORMAT, 9, 9000, 9, { tag: 6 }));
  await until(() => stream.pose?.epoch === 4);
  assert.deepEqual([stream.surface.facts.rank, stream.pose.coefficients.length], [RANK, 3 * RANK]);
});

test('ALearntSurfaceIsShownWithoutItsColumnsUntilTheyAreThere', async () => {
  const { id, section, sectionId, rank, basis, format } = learnt({ hasSection: false });
  const stream = broker.watch('lab/horse');
  await until(() => fake.last);
  fake.say(live({ asset: id, format }));
  fake.send(joinOf(format, 9, 9000, 9));
  await until(() => fake.requests.some((one) => one.id === sectionId) && stream.pose);
  assert.deepEqual([stream.surface.isComplete, stream.pose.coefficients.length], [false, 3 * RANK]);
  fake.objects.set(sectionId, section);
  await until(() => stream.surface.isComplete);
  fake.send(joinOf(format, 10, 10_000, 10));
  await until(() => stream.pose.sequence === 10n);
  assert.deepEqual([stream.surface.facts.rank, stream.pose.coefficients.length], [rank, 3 * rank]);
  await checkBasis(stream, basis, rank);
});

test('PosesAreRebuiltAtALevel', async () => {
  const stream = broker.watch('lab/horse');
  await assert.rejects(stream.rebuild({ coefficients: new Float64Array(3), channels: 3 }), { code: 'not-found' });
  await until(() => fake.last);
  fake.say(live());
  await until(() => stream.surface?.isComplete);
  const { q, n } = golden.golden;
  const whole = await stream.rebuild({ coefficients: stream.surface.rest, channels: 3 });
  assert.deepEqual([whole.vertices, whole.positions.length, whole.normals.length, whole.epoch], [n, 3 * n, 3 * n, 3]);
  const again = await stream.rebuild({ coefficients: stream.surface.rest, channels: 3, trianglesVersion: whole.trianglesVersion, room: { positions: whole.positions.buffer } });
  assert.equal(again.triangles, undefined);
  const least = await stream.rebuild({ coefficients: stream.surface.rest, channels: 3, level: 1 });
  assert.equal(least.vertices, q);
  await assert.rejects(stream.rebuild({ coefficients: new Float64Array(3), channels: 3 }), { code: 'invalid-argument' });
});

test('AStreamIsWatchedOnceForAConnection', async () => {
  broker.watch('lab/horse');
  const second = broker.watch('lab/horse');
  const error = await second.once('error');
  assert.equal(error.code, 'invalid-argument');
});

test('ControlMessagesOfTheGoldenFileAreRead', async () => {
  const { readFileSync } = await import('node:fs');
  const { GOLDEN } = await import('./support.mjs');
  for (const line of readFileSync(`${GOLDEN}/control.jsonl`, 'utf8').trimEnd().split('\n')) {
    const message = readControl(line);
    const { op } = JSON.parse(line);
    assert.equal(message?.op, ['stream', 'remember', 'ping', 'pong', 'notice', 'error', 'bye'].includes(op) ? op : undefined, line);
    if (op === 'ping' || op === 'pong' || op === 'bye') assert.equal(writeControl(op, Object.fromEntries(Object.entries(message).filter(([name]) => name !== 'op'))), line);
  }
});

test('TheMemoryOfAStreamIsFetchedAcknowledgedAndForgotten', async () => {
  const { memory, format, frames, expected } = goldenStreams().find((one) => one.memory);
  const ids = memory.segments.map((segment) => core.sha256(segment)), fetched = () => fake.requests.filter(({ id }) => ids.includes(id)).map(({ id }) => id);
  memory.segments.forEach((segment, i) => fake.objects.set(ids[i], segment));
  const { stream_id, tag } = expected[0], announced = (epoch) => live({ asset: memory.asset, format, stream_id, tag, epoch });
  const acks = () => said(fake.last, 'ack').map(({ items }) => items[0].generation ?? 0);
  /** Until the client says that it holds this, which it does once. */
  const holds = (generation) => until(() => (fake.send(frames[0]), acks().includes(generation)), `generation ${generation}`);
  const holdsNoOther = async () => {
    const before = acks().length;
    await until(() => (fake.send(frames[0]), acks().length > before + 2), 'acknowledgements');
    assert.deepEqual(acks().slice(before).filter((generation) => generation !== 0), []);
  };
  const remember = (generation, kept, segments) => fake.say({ op: 'remember', stream: 'lab/horse', generation, ...(kept ? { kept } : {}), segments });
  const stream = broker.watch('lab/horse');
  await until(() => fake.last);
  fake.say(announced(1));
  fake.send(frames[0]);
  await holdsNoOther();
  remember(4, 0, [ids[0]]);
  await holds(4);
  remember(5, 1, ids.slice(1));
  await holds(5);
  await holdsNoOther();
  assert.deepEqual(fetched(), ids, 'each once');
  for (const frame of frames) fake.send(frame);
  const keys = new Set(expected.filter(({ kind }) => kind === 'key' || kind === 'join').map(({ sequence }) => sequence)).size;
  await until(() => stream.status.counts.keys === keys, 'all keys, each once');
  assert.equal(stream.status.counts.rejected, 0);

  fake.say(announced(2));
  await holdsNoOther();
  remember(9, 0, ids);
  await holds(9);
  remember(10, 0, [ids[1] ?? ids[0], 'f'.repeat(64)]);
  await holdsNoOther();
  assert.equal(stream.status.counts.rejected, 0, 'what never comes stops no frame');
  remember(11, 0, ids);
  await holds(11);
  remember(12, 9, []);
  await holdsNoOther();

  fake.last.socket.terminate();
  await until(() => fake.connections.length === 2);
  fake.say(announced(2));
  await holdsNoOther();
  const before = fetched().length;
  remember(9, 0, ids);
  await holds(9);
  assert.equal(fetched().length, before + ids.length, 'nothing of it was kept');
});

// A page that is hidden and shown at once acknowledges frames of before, to a broker that takes these for the new ones'.
test('AMemoryStaysOverAPause', async () => {
  const { memory, format, frames, expected } = goldenStreams().find((one) => one.memory);
  const ids = memory.segments.map((segment) => core.sha256(segment));
  memory.segments.forEach((segment, i) => fake.objects.set(ids[i], segment));
  const { stream_id, tag } = expected[0], info = live({ asset: memory.asset, format, stream_id, tag, epoch: 1 }), remember = { op: 'remember', stream: 'lab/horse', generation: 4, segments: ids };
  const stream = broker.watch('lab/horse');
  await until(() => fake.last);
  fake.say(info);
  fake.say(remember);
  await until(() => (fake.send(frames[0]), said(fake.last, 'ack').some(({ items }) => items[0].generation === 4)), 'the memory');
  fake.objects.clear();
  const recalled = frames.find((frame, i) => expected[i].kind === 'join' && (frame[0] & 32) !== 0);
  stream.pause();
  stream.resume();
  await until(() => said(fake.last, 'subscribe').length === 1);
  assert.equal(said(fake.last, 'unsubscribe').length, 1);
  fake.say(info);
  fake.say({ ...remember, generation: 5 });
  fake.say({ op: 'ping', id: 1, time_us: 1 });
  await until(() => said(fake.last, 'pong').length > 0);
  fake.send(recalled);
  fake.say({ ...info, state: 'stalled' });  // What is counted comes with it.
  await until(() => stream.status.state === 'stalled');
  assert.equal(stream.status.counts.rejected, 0);
  await until(() => (fake.send(frames[0]), said(fake.last, 'ack').some(({ items }) => items[0].generation === 5)), 'the same memory, by its new number');
});

test('ScalarChannelsAreReadAndChecked', () => {
  const read = (scalars, more = {}) => readControl(JSON.stringify(live({ format: { ...FORMAT, channels: 5, scalars, ...more } }))).format.scalars;
  const heat = { name: 'heat', unit: 'K', low: -2, high: 7, scale: 0.5 };
  assert.deepEqual(read([heat, { name: 'x', scale: 1 }]), [heat, { name: 'x', unit: '', low: 0, high: 0, scale: 1 }]);
  assert.deepEqual(read([]), []);
  for (const wrong of [[heat], [heat, heat], [heat, { name: 'x' }], [heat, { name: '', scale: 1 }], [heat, { name: '..', scale: 1 }], [heat, { name: 'a/b', scale: 1 }], [heat, { name: 'x', scale: 0 }],
    [heat, { name: 'x', scale: 1e31 }], [heat, { name: 'x', scale: 1, low: 1 }], [heat, { name: 'x', scale: 1, unit: 'a\n' }], [heat, { name: 'x', scale: 1, unit: 'µµµµµµµµµ' }], [heat, 7], 'heat'])
    assert.throws(() => read(wrong), { code: 'corrupt' }, JSON.stringify(wrong));
});

test('WhereAPastIsIsChecked', () => {
  const read = (rewind) => readControl(JSON.stringify(live({ rewind }))).rewind, good = { at_us: 1_800_000_000_000_000, capture_us: 17, speed: 0.5 };
  assert.deepEqual(read(good), { at_us: 1_800_000_000_000_000n, capture_us: 17n, speed: 0.5 });
  for (const wrong of [7, null, {}, { at_us: 'x' }, { at_us: -1 }, { at_us: 0.5 }, { capture_us: 2 ** 62 }, { speed: 11 }, { speed: 0.05 }, { speed: 'x' }])
    assert.throws(() => read(Object(wrong) === wrong && Object.keys(wrong).length > 0 ? { ...good, ...wrong } : wrong), { code: 'corrupt' }, JSON.stringify(wrong));
});

test('NumbersAreReadToTheLastDigitOutsideStringsAlone', () => {
  const read = (id) => readControl(`{"op":"ping","id":${id},"time_us":1}`).id;
  assert.equal(read('18446744073709551615'), 2n ** 64n - 1n);
  assert.equal(read('9007199254740993'), 9007199254740993n);
  for (const id of ['18446744073709551616', '-1234567890123456789', '1234567890123456789.5', '1e20', '12345678901234567890123', '"9007199254740993"'])
    assert.throws(() => read(id), { code: 'corrupt' }, id);
  const digits = '1234567890123456789';
  assert.equal(readControl(`{"op":"notice","message":"a ${digits} \\" ${digits}"}`).message, `a ${digits} " ${digits}`);
  const hostile = `"${'\\"'.repeat(30_000)}`;
  for (let i = 0; i < 50; ++i) assert.throws(() => readControl(hostile), { code: 'corrupt' });  // Work grows with the length alone.
});

test('UrlsMeanWhatTheyMeanEverywhere', () => {
  assert.deepEqual(brokerUrl('https://host/sub/path/'), { base: 'https://host/sub/path', token: '' });
  assert.deepEqual(brokerUrl('wss://host:444/sub/v1/subscribe?access_token=a.b'), { base: 'https://host:444/sub', token: 'a.b' });
  assert.equal(brokerUrl('host').base, 'http://host:7490');
  assert.equal(brokerUrl('host:1234/x').base, 'http://host:1234/x');
  assert.equal(brokerUrl('[::1]').base, 'http://[::1]:7490');
  const { broker: where, stream, query } = streamUrl('https://host/lab/horse?rate=raw&access_token=t');
  assert.deepEqual([where, stream, String(query)], [{ base: 'https://host', token: 't' }, 'lab/horse', 'rate=raw']);
  assert.deepEqual(streamUrl('ws://h/p/v1/subscribe/lab/horse').broker.base, 'http://h/p');
  assert.deepEqual(streamUrl('https://h/p/lab/horse', '', '/p').stream, 'lab/horse');
  for (const bad of ['ftp://h/x', 'https://u:p@h/x', 'https://h/../..', 'https://h/a//b', 'https://h/', `https://h/${'a'.repeat(129)}`, 'https://h/%20', 'https://h/v1/x', 'https://', 'ws://[/x']) {
    assert.throws(() => streamUrl(bad), { code: 'invalid-argument' }, bad);
  }
});

test('ProfilesOfUrlsAreCheckedBeforeTheBrokerIsAsked', () => {
  const of = (query) => internals.profileIn(new URLSearchParams(query));
  assert.deepEqual(of('rate=raw&bands=2'), { rate: 'raw', bands: 2 });
  assert.deepEqual(of('rate=4&scheme=catmull-rom'), { rate: 'interpolated', k: 4, scheme: 'catmull-rom' });
  assert.deepEqual(of('rate=1'), { rate: 'raw' });
  for (const bad of ['rate=fast', 'rate=', 'rate=1.5', 'k=x', 'bands=', 'form=full', 'scheme=cubic', 'speed=2', 'constructor=1', '__proto__=1'])
    assert.throws(() => of(bad), { code: 'invalid-argument' }, bad);
});

test('PausesGrowAndRefusalsTakeTheLongest', () => {
  const retry = new Retry();
  const lost = { code: 'disconnected', message: '' };
  assert.deepEqual([1, 2, 3, 4, 5, 6, 7].map(() => retry.after(lost, undefined, undefined, 0.5)), [200, 400, 800, 1600, 3200, 5000, 5000]);
  assert.equal(retry.after(lost, 60_000, undefined, 0.5), 200);
  assert.equal(retry.after({ ...lost, refused: true }, undefined, undefined, 0.5), 5000);
  assert.equal(retry.after({ ...lost, forGood: true }, undefined, undefined, 0.5), 0);
  assert.equal(retry.after(lost, 60_000, 20_000, 0), 20_000);
  assert.equal(retry.after(lost, undefined, 4e9, 0), 600_000);
  assert.deepEqual([0, 400, 3940, 31_000].map(tryAgainIn), ['', '; next try in 400 ms', '; next try in 3.9 s', '; next try in 31 s']);
});
