// SPDX-License-Identifier: MIT
//
// The client with a real broker and a real sender, whose programs are in the folder EIGENCAST_BIN; by a worker, too.
import assert from 'node:assert/strict';
import { spawnSync } from 'node:child_process';
import { existsSync, readFileSync, readdirSync, writeFileSync } from 'node:fs';
import { connect as connectTo, createServer } from 'node:net';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { pathToFileURL } from 'node:url';
import { Worker as NodeWorker } from 'node:worker_threads';
import { FrameDecoder, stepSize } from '../../../sdk/js/frames.mjs';
import { environment, until, ws } from '../unit/fake_broker.mjs';
import { BUILD, internals, sameBits, wasm, writerWasm } from '../unit/support.mjs';
import { startSite } from '../browser/site.mjs';
import { BIN, Programs } from './programs.mjs';

const { Core, connect, inStep, Playout, publish, watch } = internals;
const programs = new Programs();
const startBroker = (...given) => programs.broker(...given);
const startSender = (broker, name, ...more) => programs.sender(broker, name, 'heart', '--rank', '24', ...more);

let shared, sender;
before(async () => {
  shared = await startBroker();
  sender = startSender(shared, 'lab/heart', '--memory', 'off');  // The reference fetches nothing: its keys would be others.
});
after(() => programs.stop());

const options = { core: wasm, worker: false, environment };
const urlOf = (broker, path = '') => `http://127.0.0.1:${broker.port}${path}`;

/** On a busy machine the broker may leave bands out for one of the two. */
function assertSameBands(pose, reference, what) {
  pose.bandEnds.forEach((end, b) => {
    if (((pose.bands & reference.bands) >> b & 1) === 0) return;
    const first = pose.channels * (pose.bandEnds[b - 1] ?? 0), last = pose.channels * end;
    assert.ok(sameBits(pose.coefficients.subarray(first, last), reference.values.slice(first, last)), `${what}, band ${b}`);
  });
}

test('StreamsAreListedAndWatched', async () => {
  const broker = await connect(urlOf(shared), options);
  const [listed] = await until(async () => {
    const all = await broker.streams();
    return all.length > 0 && all;
  }, 'the stream in the list', 150_000);
  assert.equal(listed.stream, 'lab/heart');
  const stream = broker.watch(listed.stream);
  await until(() => stream.surface?.isComplete && stream.status.state === 'live' && stream.pose, 'a whole surface, live');
  assert.equal(stream.surface.asset, listed.asset);
  assert.equal(stream.surface.facts.rank, 24);
  const made = await stream.rebuild({ coefficients: stream.pose.coefficients, channels: stream.pose.channels });
  assert.equal(made.vertices, stream.surface.facts.vertexCount);
  assert.ok(made.positions.every(Number.isFinite) && made.normals.every(Number.isFinite));
  broker.close();
});

test('KeysOfAMemoryAreThoseThatTheReferenceDecoderReads', async () => {
  const remembering = startSender(shared, 'lab/again', '--memory', 'on', '--rate', '60'), came = [];
  class Tapped extends ws.WebSocket {
    constructor(...given) {
      super(...given);
      this.on('message', (data, isBinary) => came.push(isBinary ? new Uint8Array(data) : JSON.parse(String(data))));
    }
  }
  const stream = await watch(urlOf(shared, '/lab/again?rate=raw'), { ...options, environment: { ...environment, WebSocket: Tapped } }), poses = new Map();
  stream.on('pose', (pose) => poses.set(pose.sequence, pose));
  const isRecalled = (message) => message instanceof Uint8Array && (message[0] & 32) !== 0;
  try {
    await until(() => came.filter(isRecalled).length > 60, 'frames of a memory', 150_000);
  } finally {
    stream.close();
    await remembering.stop();
  }
  let decoder, asset, epoch;
  const expected = new Map();  // The join that a memory begins with replaces the last key's pose.
  for (const message of came) {
    // Within an epoch what is said of it changes, but its memory stays.
    if (message.op === 'stream' && message.format && message.epoch !== epoch) [decoder, asset, epoch] = [new FrameDecoder({ ...message.format, scheme: 'linear' }), message.asset, message.epoch];
    if (message.op === 'remember') decoder.keepSegments(message.kept ?? 0);
    for (const id of message.op === 'remember' ? message.segments : [])
      decoder.addSegment(Buffer.from(asset, 'hex'), new Uint8Array(await (await fetch(urlOf(shared, `/v1/assets/${id}`))).arrayBuffer()));
    if (!(message instanceof Uint8Array)) continue;
    const frame = decoder.decode(message), key = frame.pose ?? frame.newer;
    expected.set(frame.sequence, { isRecalled: isRecalled(message), bands: key.bands, values: Array.from(key.values, (q) => q * stepSize(key.step)) });
  }
  let recalled = 0;
  for (const [sequence, shown] of poses) {
    assertSameBands(shown, expected.get(sequence), String(sequence));
    recalled += expected.get(sequence).isRecalled ? 1 : 0;
  }
  assert.ok(recalled > 50, `${recalled} of ${came.filter(isRecalled).length}`);
  assert.equal(stream.status.counts.rejected, 0);
});

test('PosesAreThoseThatTheReferenceDecoderReads', async () => {
  for (const query of ['rate=raw', 'rate=interpolated', 'rate=interpolated&k=4&scheme=catmull-rom', 'rate=estimated']) {
    const expected = new Map();
    let decoder, previousUs = 0n, newestUs = 0n;
    const socket = new ws.WebSocket(`ws://127.0.0.1:${shared.port}/v1/subscribe/lab/heart?${query}`, 'eigencast.v2');
    socket.on('message', (data, isBinary) => {
      const message = isBinary ? undefined : JSON.parse(String(data));
      if (message?.op === 'stream' && message.format) decoder = new FrameDecoder({ ...message.format, scheme: message.profile.scheme ?? (message.profile.rate === 'estimated' ? 'damped' : 'linear') });
      if (!isBinary || !decoder) return;
      const frame = decoder.decode(new Uint8Array(data));
      if (frame?.kind === 'join' || frame?.kind === 'key') [previousUs, newestUs] = [frame.kind === 'join' ? frame.captureUs - frame.ageUs : newestUs, frame.captureUs];
      const isAhead = ((frame?.flags ?? 0) & 1) !== 0, key = isAhead ? frame.shown : (frame?.pose ?? frame?.newer);
      const shownUs = isAhead ? previousUs + ((newestUs - previousUs) * BigInt(frame.at)) / BigInt(frame.of || 1) : frame?.captureUs;
      if (key) expected.set(`${isAhead ? 'step' : frame.kind} ${frame.sequence} ${shownUs}`, { bands: key.bands, values: Array.from(key.values, (q) => q * stepSize(key.step)) });
    });
    const stream = await watch(urlOf(shared, `/lab/heart?${query}`), options);
    let same = 0, poses = [];
    stream.on('pose', (pose) => poses.push(pose));
    /** The reference may come later, or was dropped there. */
    const isUnmatched = (pose) => {
      const reference = expected.get(`${pose.kind} ${pose.sequence} ${pose.captureUs}`);
      if (!reference) return true;
      assertSameBands(pose, reference, `${query}: ${pose.kind} ${pose.captureUs}`);
      ++same;
      return false;
    };
    try {
      await until(() => {
        poses = poses.filter(isUnmatched);
        return same >= 20;
      }, `twenty poses of ${query}`, 150_000);
    } finally {
      socket.terminate();
      stream.close();
    }
  }
});

test('AGroupShowsOneMomentAsLateAsItsSlowest', async () => {
  const LATE_MS = 120, core = await Core.make(wasm);
  class Slow extends ws.WebSocket {
    set onmessage(hear) {
      super.onmessage = (event) => (typeof event.data === 'string' ? hear(event) : setTimeout(() => hear(event), LATE_MS));
    }
  }
  const viewers = await Promise.all([[0, ws.WebSocket], [7_000_000, Slow]].map(async ([aheadUs, WebSocket]) => {
    const nowUs = () => Math.round((performance.timeOrigin + performance.now()) * 1000) + aheadUs;
    const broker = await connect(urlOf(shared), { ...options, environment: { ...environment, WebSocket, nowUs } }), stream = broker.watch('lab/heart', { profile: { rate: 'raw' }, sync: 'group' });
    const playing = inStep(new Playout(core), broker, stream);
    stream.on('pose', ({ captureUs, arrivalUs, coefficients, bands }) => playing.add(captureUs, BigInt(arrivalUs), coefficients, bands, false));
    return { broker, playing, shownUs: () => playing.at(BigInt(nowUs()))?.timeUs };
  }));
  // A native viewer, where there is one, says what it drew, and when by the clock of this machine.
  const shown = join(programs.folder, 'in-step.jsonl'), hasNative = existsSync(join(BIN, 'eigencast-client'));
  const native = hasNative ? programs.start('eigencast-client', urlOf(shared, '/lab/heart'), '--headless', '--size=64x48', '--rate=raw', '--sync=group', `--record-shown=${shown}`, '--wait=150') : undefined;
  const nativeMoment = () => {
    const line = existsSync(shown) ? readFileSync(shown, 'utf8').split('\n').at(-2) : undefined;
    return line ? JSON.parse(line).capture_us - JSON.parse(line).drawn_us : NaN;
  };
  try {
    await until(() => {
      const ourUs = Number(process.hrtime.bigint() / 1000n), [first, slow] = viewers.map(({ shownUs }) => Number(shownUs()));
      const isNear = !hasNative || Math.abs(nativeMoment() - (first - ourUs)) < 50_000; // A busy machine draws it late.
      return isNear && Math.abs(first - slow) < 10_000 && viewers[0].playing.delayUs > 0.9 * 1000 * LATE_MS;
    }, 'the same moment', 150_000);
  } finally {
    await native?.stop();
    for (const { broker, playing } of viewers) {
      broker.close();
      playing.free();
    }
  }
});

/** A way to a broker on which all takes so long, either way. */
function lateWay(port, lateMs) {
  const server = createServer((near) => {
    const far = connectTo(port, '127.0.0.1');
    for (const [from, to] of [[near, far], [far, near]]) {
      from.on('data', (bytes) => setTimeout(() => to.writable && to.write(bytes), lateMs));
      from.on('close', () => to.destroy()).on('error', () => {});
    }
  });
  return new Promise((resolve) => server.listen(0, '127.0.0.1', () => resolve(server)));
}

test('APoseHasOneTimecodeLiveInThePastAndRecorded', { skip: !existsSync(join(BIN, 'eigencast-client')) && 'no eigencast-client' }, async () => {
  const broker = await startBroker(0, '--history-streams=**', '--recording-streams=**', '--recording-include-asset=true'), url = urlOf(broker, '/lab/heart');
  const playing = startSender(broker, 'lab/heart'), began = Date.now();
  /** Poses as they were sent, until they are `enough`: when each was captured, by its coefficients. */
  const seen = async (name, enough, ...what) => {
    const shown = join(programs.folder, `timecode-${name}.jsonl`), viewer = programs.start('eigencast-client', ...what, '--headless', '--size=64x48', `--record-shown=${shown}`, ...(what[0] === url ? ['--wait=150'] : []));
    const poses = () => (existsSync(shown) ? readFileSync(shown, 'utf8').split('\n').slice(0, -1) : []).map((line) => JSON.parse(line)).filter((one) => one.shown === 'live' && !one.settling && one.utc_us !== null);
    const times = () => {
      const by = new Map();
      for (const { coefficients, utc_us } of poses()) by.set(String(coefficients), [...(by.get(String(coefficients)) ?? []), utc_us]);
      return by;
    };
    try {
      await until(() => enough(times()), `poses ${name}`, 150_000);
    } finally {
      await viewer.stop();
    }
    return times();
  };
  const live = await seen('live', (by) => [...by.values()].flat().length > 60, url, '--rate=raw'), [first] = [...live.values()].flat();
  assert.ok(Math.abs(first / 1000 - Date.now()) < 200_000, 'UTC');
  const isNear = (a, b) => Math.abs(a - b) <= 2;  // At half the speed times are rounded.
  const same = (other) => [...other].filter(([coefficients, times]) => times.some((us) => live.get(coefficients)?.some((one) => isNear(us, one)))).length;
  const isEnough = (other) => same(other) > 20;
  await seen('past', isEnough, url, '--rate=raw', `--ago=${Math.ceil((Date.now() - began) / 1000) + 5}`, '--speed=0.5');
  playing.kill();
  await playing.ended;
  await broker.stop();
  const folder = join(broker.data, 'recordings');
  await seen('recorded', isEnough, join(folder, readdirSync(folder)[0]));
});

test('StreamsOfSeveralBrokersShowOneMoment', { skip: !existsSync(join(BIN, 'eigencast-client')) && 'no eigencast-client' }, async () => {
  const LATE_MS = 60, other = await programs.broker(), way = await lateWay(other.port, LATE_MS), shown = join(programs.folder, 'brokers.jsonl');
  programs.sender(other, 'lab/heart', 'heart', '--rank', '24');
  const native = programs.start('eigencast-client', urlOf(shared, '/lab/heart'), `http://127.0.0.1:${way.address().port}/lab/heart`, '--headless', '--size=64x48', '--rate=raw', '--sync=brokers', `--record-shown=${shown}`, '--wait=150');
  /** How late each surface is, in the last pictures of both. */
  const last = () => {
    const by = new Map(), lines = existsSync(shown) ? readFileSync(shown, 'utf8').split('\n').slice(-60, -1) : [];
    for (const { surface, drawn_us, capture_us } of lines.filter((line) => line !== '').map((line) => JSON.parse(line))) by.set(drawn_us, { ...by.get(drawn_us), [surface]: drawn_us - capture_us });
    return [...by.values()].filter((one) => 0 in one && 1 in one);
  };
  try {
    // Of a broker that is near as much is held back as the way to the other takes.
    await until(() => last().length > 20 && last().every((late) => Math.abs(late[0] - late[1]) < 8_000 && late[0] > 0.9 * 1000 * LATE_MS), 'the same moment', 150_000);
  } finally {
    await native.stop();
    way.close();
    await other.stop();
  }
});

test('AnotherProfileIsGivenWithoutANewConnection', async () => {
  const stream = await watch(urlOf(shared, '/lab/heart'), options);
  await until(() => stream.info?.state === 'live');
  assert.equal(stream.info.profile.rate, 'interpolated');
  stream.setProfile({ rate: 'raw', bands: 1 });
  await until(() => stream.info.profile.rate === 'raw');
  assert.equal(stream.info.profile.bands, 1);
  await until(() => stream.pose?.bands === 1);
  const { rest } = stream.surface;
  const first = 3 * stream.pose.bandEnds[0];
  assert.deepEqual(Array.from(stream.pose.coefficients.subarray(first)), Array.from(rest.subarray(first)), 'absent bands are those of the rest pose');
  assert.equal(stream.status.reconnects, 0);
  stream.close();
});

test('ASenderThatEndsLeavesItsLastPose', async () => {
  const leaving = startSender(shared, 'lab/leaving');
  const stream = await watch(urlOf(shared, '/lab/leaving'), options);
  await until(() => stream.status?.state === 'live' && stream.pose);
  await leaving.stop('SIGKILL');
  await until(() => stream.status.state === 'stalled', 'stalled');
  startSender(shared, 'lab/leaving');
  await until(() => stream.status.state === 'live', 'live again');
  stream.close();
});

test('ABrokerThatComesBackIsFound', async () => {
  const first = await startBroker();
  startSender(first, 'x');
  const stream = await watch(urlOf(first, '/x'), options);
  await until(() => stream.status?.state === 'live' && stream.pose);
  await first.stop();
  await until(() => stream.status.state === 'lost', 'lost');
  assert.match(stream.status.detail, /next try in/);
  await startBroker(first.port);
  const before = stream.pose;
  await until(() => stream.status.state === 'live' && stream.pose !== before, 'live again');
  assert.equal(stream.status.reconnects, 1);
  stream.close();
});

test('TokensAreAskedForGivenAndRefusedWithWords', async () => {
  const made = spawnSync(join(BIN, 'eigencast-broker'), ['token', 'create', '--static', '--subject=viewer', '--subscribe=lab/*'], { encoding: 'utf8' });
  const tokens = join(programs.folder, 'tokens');
  writeFileSync(tokens, `${made.stderr.trim().split('\n').at(-1)}\n`, { mode: 0o600 });
  const process = await startBroker(0, '--access-anonymous=nowhere', `--access-tokens-file=${tokens}`);
  const stranger = await watch(urlOf(process, '/lab/x'), options);
  await until(() => stranger.status?.state === 'refused', 'a refusal');
  assert.match(stranger.status.detail, /answered 401.*give a token.*next try in/);
  await assert.rejects((await connect(urlOf(process), options)).streams(), { message: /401/ });
  const wrong = await watch(urlOf(process, '/lab/x'), { ...options, token: 'wrong' });
  await until(() => wrong.status?.state === 'refused', 'a refusal');
  assert.match(wrong.status.detail, /answered 401.*does not do/);
  const viewer = await watch(urlOf(process, `/lab/x?access_token=${made.stdout.trim()}`), options);
  await until(() => viewer.status?.state === 'waiting', 'the right to watch');
  const elsewhere = await watch(urlOf(process, '/other'), { ...options, token: made.stdout.trim() });
  await until(() => elsewhere.status?.state === 'refused', 'a refusal');
  assert.match(elsewhere.status.detail, /answered 403/);
  for (const one of [stranger, wrong, viewer, elsewhere]) one.close();
});

test('PeersPublishForOneAnother', async () => {
  const heart = await watch(urlOf(shared, '/lab/heart'), options);
  const { asset } = await until(() => heart.surface, 'the surface', 150_000);
  heart.close();
  const publishing = { ...options, writer: writerWasm, asset };
  const [a, b] = await Promise.all(['a', 'b'].map((name) => publish(urlOf(shared, `/play/${name}`), publishing)));
  const [fromA, fromB] = await Promise.all(['a', 'b'].map((name) => watch(urlOf(shared, `/play/${name}?rate=raw`), options)));
  const moved = (publisher, first) => publisher.rest.map((value, i) => (i === 0 ? first : value));
  // b answers each pose of a by one moved twice as far.
  fromA.on('pose', ({ coefficients }) => b.send(moved(b, 2 * coefficients[0])));
  const { boxHigh, boxLow, area, rank } = a.facts, bound = 0.01 * Math.hypot(...boxHigh.map((high, i) => high - boxLow[i])) * Math.sqrt(area);
  for (const first of [0.5, -0.25, 1]) {
    await until(() => {
      a.send(moved(a, first));
      return fromB.pose && Math.abs(fromB.pose.coefficients[0] - 2 * first) < bound;
    }, `the answer to ${first}`);
  }
  assert.equal(fromA.pose.coefficients.length, 3 * rank);
  await until(() => a.status.subscribers === 1, 'a subscriber');
  assert.throws(() => a.send([1, 2, 3]), { code: 'invalid-argument' });
  assert.equal(a.send(a.rest, 1), false, 'not after the one before');
  const second = await publish(urlOf(shared, '/play/a'), publishing);
  await until(() => second.status.state === 'refused', 'a refusal');
  assert.equal(second.send(second.rest), false);
  assert.equal(a.status.state, 'live');
  await assert.rejects(publish(urlOf(shared, '/play/c'), { ...publishing, asset: '0'.repeat(64) }), { code: 'not-found' });
  for (const one of [a, b, second, fromA, fromB]) one.close();
  assert.equal(a.send(a.rest), false);
});

test('APublisherComesBackWhenItsConnectionIsLost', async () => {
  const { asset } = (await (await connect(urlOf(shared), options)).streams()).find(({ stream }) => stream === 'lab/heart');
  const sockets = [];
  class Watched extends ws.WebSocket {
    constructor(...words) {
      super(...words);
      sockets.push(this);
    }
  }
  const publisher = await publish(urlOf(shared, '/play/d'), { ...options, environment: { WebSocket: Watched }, writer: writerWasm, asset });
  const states = [];
  publisher.on('status', ({ state, detail }) => states.push(`${state}: ${detail}`));
  const stream = await watch(urlOf(shared, '/play/d?rate=raw'), options);
  await until(() => (publisher.send(publisher.rest), stream.pose), 'a pose');
  sockets[0].terminate();
  await until(() => sockets.length === 2 && publisher.status.state === 'live', 'live again');
  assert.ok(states.some((one) => /^lost: connection to ws:.* lost; next try in/.test(one)), JSON.stringify(states));
  const before = stream.pose;
  await until(() => (publisher.send(publisher.rest), stream.pose !== before), 'a pose of the new chain');
  publisher.close();
  await until(() => stream.status.state === 'stalled', 'stalled');
  stream.close();
});

test('ASenderThatComesBackIsFollowed', async () => {
  let mine = startSender(shared, 'lab/again');
  const stream = await watch(urlOf(shared, '/lab/again?rate=raw'), options);
  const isFollowed = () => stream.pose && stream.surface?.isComplete && stream.surface.epoch === stream.pose.epoch;
  await until(isFollowed, 'a pose of the surface', 150_000);
  const { epoch, asset } = stream.surface;
  await mine.stop('SIGKILL');
  mine = startSender(shared, 'lab/again');
  await until(() => stream.pose.epoch !== epoch && isFollowed(), 'a pose of the next epoch, and the surface with it', 150_000);
  assert.equal(stream.surface.asset, asset);
  stream.close();
  await mine.stop('SIGKILL');
});

test('ScalarsRideOnPublishedPoses', async (t) => {
  const { asset } = (await (await connect(urlOf(shared), options)).streams()).find(({ stream }) => stream === 'lab/heart');
  const publishing = { ...options, writer: writerWasm, asset };
  const publisher = await publish(urlOf(shared, '/play/warm'), { ...publishing, scalars: [{ name: 'warmth', unit: 'K', low: 270, high: 320 }, { name: 'flag' }] });
  const stream = await watch(urlOf(shared, '/play/warm?rate=raw'), options), { rank } = publisher.facts;
  t.after(() => [publisher, stream].forEach((one) => one.close()));
  assert.equal(publisher.rest.length, 5 * rank);
  // What an error of 0.05 K over the surface is in a coefficient, at most; and a hundred times that.
  const near = 0.05 * Math.sqrt(3 * publisher.facts.area), pose = publisher.rest.map((value, i) => (i % 5 === 3 ? (100 * near) / (1 + Math.floor(i / 5)) : value));
  await until(() => (publisher.send(pose), stream.pose), 'a pose');
  const [{ scale: _scale, ...warmth }, flag] = stream.info.format.scalars;
  assert.deepEqual([warmth, flag], [{ name: 'warmth', unit: 'K', low: 270, high: 320 }, { name: 'flag', unit: '', low: 0, high: 0, scale: 1 }]);
  const { coefficients, channels } = stream.pose;
  assert.equal(channels, 5);
  for (let row = 0; row < rank; ++row) {
    const got = coefficients[5 * row + 3];
    assert.ok(Math.abs(got - pose[5 * row + 3]) < near, `row ${row}: ${got} for ${pose[5 * row + 3]}`);
  }
  assert.throws(() => publisher.send(pose.slice(1)), { code: 'invalid-argument' });
  await assert.rejects(publish(urlOf(shared, '/play/wrong'), { ...publishing, scalars: Array.from({ length: 14 }, (_, i) => ({ name: `s${i}` })) }), { code: 'invalid-argument' });
});

test('UrlsBehindAPathOfAProxyAreFound', async () => {
  const proxy = await startSite(shared.port, { prefix: '/behind/a/proxy' });
  const stream = await watch(`${proxy.url}/lab/heart?rate=raw`, options);
  await until(() => stream.pose && stream.surface?.isComplete, 'a pose');
  assert.deepEqual([stream.name, stream.info.profile.rate], ['lab/heart', 'raw']);
  const publisher = await publish(`${proxy.url}/play/e`, { ...options, writer: writerWasm, asset: stream.surface.asset });
  await until(() => publisher.send(publisher.rest), 'a pose that is sent');
  publisher.close();
  stream.close();
  await proxy.stop();
});

test('AWorkerDoesTheSame', async () => {
  const wrapper = join(programs.folder, 'wrapper.mjs');
  writeFileSync(wrapper, `
    import { parentPort } from 'node:worker_threads';
    globalThis.WebSocket = (await import('ws').catch(() => import(${JSON.stringify('/usr/share/nodejs/ws/wrapper.mjs')}))).WebSocket;
    globalThis.postMessage = (message, transfer) => parentPort.postMessage(message, transfer);
    await import(${JSON.stringify(String(pathToFileURL(join(BUILD, 'worker.js'))))});
    parentPort.on('message', (data) => globalThis.onmessage({ data }));`);
  const node = new NodeWorker(wrapper);
  const worker = { postMessage: (message, transfer) => node.postMessage(message, transfer), terminate: () => node.terminate(), onmessage: undefined };
  node.on('message', (data) => worker.onmessage?.({ data }));
  const broker = await connect(urlOf(shared), { core: wasm, worker, environment });
  const stream = broker.watch('lab/heart');
  await until(() => stream.surface?.isComplete && stream.pose, 'a pose by the worker');
  const made = await stream.rebuild({ coefficients: stream.pose.coefficients, channels: stream.pose.channels });
  const again = await stream.rebuild({
    coefficients: stream.pose.coefficients, channels: stream.pose.channels, room: { positions: made.positions.buffer, normals: made.normals.buffer }, trianglesVersion: made.trianglesVersion,
  });
  assert.equal(made.positions.byteLength, 0, 'the buffer went round');
  assert.equal(again.positions.length, 3 * stream.surface.facts.vertexCount);
  broker.close();
});

test('NativeProgramsFindABrokerBehindAPath', async () => {
  const site = await startSite(shared.port, { prefix: '/tools/eigencast', isProxy: true }), url = `${site.url}/lab/native`;
  const sender = programs.start('eigencast-sender', 'play', 'heart', '--rank', '24', '--no-progress', '--to', url);
  try {
    const listed = async (name) => (await (await connect(urlOf(shared), options)).streams()).find(({ stream }) => stream === name);
    await until(async () => (await listed('lab/native'))?.state === 'live', 'the stream under its own name', 150_000);
    assert.equal(await listed('tools/eigencast/lab/native'), undefined);
    if (!existsSync(join(BIN, 'eigencast-client'))) return console.log('no eigencast-client');
    const out = join(programs.folder, 'behind'), words = [url, '--headless', '--frames=1', '--size=64x64', '--wait=60', `--out=${out}`];
    assert.equal(await programs.start('eigencast-client', ...words).ended, 0);
    assert.ok(existsSync(join(out, 'frame_0001.png')));
  } finally {
    await sender.stop('SIGKILL');
    await site.stop();
  }
});
