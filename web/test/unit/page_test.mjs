// SPDX-License-Identifier: MIT
import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import { join } from 'node:path';
import { test } from 'node:test';
import { gzipSync } from 'node:zlib';
import { essl } from '../../shaders.mjs';
import { BUILD, internals } from './support.mjs';

const { bannerOf, Camera, checkedGroup, figureLines, History, inStep, linkOf, nameFrom, NumberPainter, otherTime, pageOf, pick, placeOf, pointFrom, positionsOf, RoomState, roundUp, tableOf, textFromMode, tileWidth, timecodeOf, utcOf } = internals;
const near = (a, b, within = 1e-9) => assert.ok(a.every((value, i) => Math.abs(value - b[i]) <= within), `${a} against ${b}`);

test('PageAndCodeTakeAtMost100Kilobytes', () => {
  const files = new Set(['page.html', 'page.css', 'page.js', 'worker.js', 'eigencast-core.wasm']);
  for (const file of files) {
    if (!file.endsWith('.js')) continue;
    for (const [, chunk] of readFileSync(join(BUILD, file), 'utf8').matchAll(/(?:from|import)\s?"\.\/(eigencast-\w+\.js)"/g)) files.add(chunk);
  }
  const sizes = [...files].map((file) => [file, gzipSync(readFileSync(join(BUILD, file)), { level: 9, memLevel: 9 }).length]);
  const total = sizes.reduce((sum, [, size]) => sum + size, 0);
  assert.ok(total <= 100_000, `${total} bytes: ${sizes.map((one) => one.join(' ')).join(', ')}`);
});

test('AllThatThePageLoadsAtOnceIsPreloaded', () => {
  const page = readFileSync(join(BUILD, 'page.html'), 'utf8');
  assert.equal(page.match(/\{web\}[\w-]+\.js/g).length, 3, 'the page, its worker, and what they share');
  for (const script of ['page.js', 'worker.js']) {
    assert.ok(page.includes(`{web}${script}`), script);
    for (const [, chunk] of readFileSync(join(BUILD, script), 'utf8').matchAll(/from"\.\/(eigencast-\w+\.js)"/g)) assert.ok(page.includes(`{web}${chunk}`), chunk);
  }
});

test('ShadersBecomeEssl', () => {
  const made = essl('#version 330 core\nin vec2 uv;  // where\nuniform sampler2DMS depth;\nvoid main() {\n  ivec2 n = textureSize(depth) - 1;\n}');
  assert.match(made, /^#version 300 es\nprecision highp float;/);
  assert.match(made, /in vec2 uv;uniform sampler2D depth;void main\(\)\{ivec2 n=textureSize\(depth,0\)- 1;\}$/);
  assert.equal(essl('vec3 f() { return vec3(1.0); }'), 'vec3 f(){return vec3(1.0);}');
});

test('TheCameraFramesItsBoxUntilItIsMoved', () => {
  const camera = new Camera();
  camera.setViewport(1000, 500);
  const corners = [[-1, -2, -3], [3, -2, -3], [-1, 2, -3], [3, 2, -3], [-1, -2, 1], [3, -2, 1], [-1, 2, 1], [3, 2, 1]];
  camera.setScene([-1, -2, -3], [3, 2, 1], corners);
  const view = camera.viewFromScene, tangent = Math.tan(0.61 / 2);
  const at = ([x, y, z]) => [0, 1, 2].map((i) => view[i] * x + view[i + 4] * y + view[i + 8] * z + view[i + 12]);
  const sides = (axis, tan) => corners.map(at).map((point) => point[axis] / -point[2] / tan).sort((a, b) => a - b);
  const across = sides(0, 2 * tangent), upward = sides(1, tangent), [left, right, below, above] = [across[0], across[7], upward[0], upward[7]];
  assert.ok(Math.abs(Math.max(right - left, above - below) / 2 - 2 / 3) < 1e-3, 'two thirds of the window');
  assert.ok(Math.abs(left + right) < 0.01 && Math.abs(below + above) < 0.01, 'in the middle');
  const eye = camera.position, target = camera.target;
  camera.setScene([-2, -4, -6], [6, 4, 2], corners.map((corner) => corner.map((x) => 2 * x)));
  assert.ok(Math.hypot(...camera.position.map((x, i) => x - camera.target[i])) > 1.9 * Math.hypot(...eye.map((x, i) => x - target[i])), 'twice the box, twice the distance');
  camera.rotate([10, 0]);
  const turned = camera.position;
  camera.setScene([-1, -2, -3], [3, 2, 1], corners);
  near(camera.position, turned);
});

test('LooksFromAnyEyeForAnyUp', () => {
  for (const up of ['x', 'y', 'z']) {
    const camera = new Camera();
    camera.up = up;
    camera.lookFrom([3, 4, 5], [1, 1, 1]);
    near(camera.position, [3, 4, 5]);
    near(camera.target, [1, 1, 1]);
  }
});

test('ZoomKeepsThePointUnderTheCursor', () => {
  const camera = new Camera();
  camera.setViewport(800, 600);
  const at = [600, 150], depth = (c) => {  // Where the ray meets the plane through the target.
    const along = c.directionThrough(at), back = c.position.map((x, i) => x - c.target[i]);
    const t = -back.reduce((s, x) => s + x * x, 0) / back.reduce((s, x, i) => s + x * along[i], 0);
    return c.position.map((x, i) => x + t * along[i]);
  };
  const before = depth(camera);
  camera.zoom(3, at);
  near(depth(camera), before, 1e-6);
});

test('TheNearestFaceOrPointIsPicked', () => {
  const camera = new Camera();
  camera.setViewport(400, 400);
  camera.lookFrom([0, 0, 5], [0, 0, 0]);
  const square = (z) => [[-1, -1, z], [1, -1, z], [1, 1, z], [-1, 1, z]].flat();
  const positions = new Float32Array([...square(0), ...square(1)]), sceneFromSurface = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
  const triangles = new Uint32Array([0, 1, 2, 0, 2, 3, 4, 5, 6, 4, 6, 7]);
  near(pick([{ positions, triangles, sceneFromSurface, radius: 0 }], camera, [200, 200]).at, [0, 0, 1], 1e-6);
  assert.equal(pick([{ positions, triangles, sceneFromSurface, radius: 0 }], camera, [2, 2]), undefined);
  const point = { positions: new Float32Array([0, 0, 2]), triangles: new Uint32Array(), sceneFromSurface, radius: 0.1 };
  near(pick([point], camera, [202, 200]).at, [0, 0, 2], 0.1);
});

test('NumbersSpanRoundNumbersAndNeverShrink', () => {
  near([0.0123, 1, 8.1, 350].map(roundUp), [0.015, 1, 10, 400]);
  const painter = new NumberPainter('movement'), style = { colourMap: 'viridis' }, facts = { metresPerUnit: 0.01 };
  assert.equal(painter.legend(style, facts), undefined, 'nothing is known yet');
  for (const [range, span] of [[[0.1, 0.33], [0, 0.4]], [[0, 0.1], [0, 0.4]], [[-0.7, 0.2], [-0.8, 0.8]]]) {
    painter.include(range);
    near(painter.span(style), span);
  }
  assert.deepEqual(painter.span({ colourRange: [1, 2] }), [1, 2]);
  const { title, unit, low, high, colours } = painter.legend(style, facts);
  assert.deepEqual([title, unit, low, high], ['movement from rest', 'm', -0.008, 0.008]);
  assert.deepEqual([colours[0], colours.at(-1)], ['#440154', '#fde725']);
});

test('NumbersAreMovementSpeedAndChannels', () => {
  const rest = Float64Array.of(1, 0, 0, 0, 1, 0), format = { channels: 7, velocity_channels: 3, velocity_us: 500_000, scalars: [{ name: 'stress', unit: 'MPa', low: -2, high: 2, scale: 1 }] };
  const pose = { coefficients: Float64Array.of(3, 4, 5, 6, 7, 8, 9, 1, 2, 3, 4, 5, 6, 7), channels: 7, rest, timeUs: 0n, info: { format } };
  const of = (colour, given = pose) => { const found = new NumberPainter(colour).of(given); return found && { isLength: found.isLength, coefficients: [...found.coefficients] }; };
  assert.deepEqual(of('movement'), { isLength: true, coefficients: [2, 4, 5, 1, 1, 3] });
  assert.deepEqual(of('speed'), { isLength: true, coefficients: [14, 16, 18, 10, 12, 14] }, 'per second');
  for (const channel of ['channel:stress', 'channel:3']) assert.deepEqual(of(channel), { isLength: false, coefficients: [6, 0, 0, 4, 0, 0] });
  for (const none of ['channel:heat', 'channel:7', 'channel:2']) assert.equal(of(none), undefined);
  const still = { ...pose, coefficients: rest, channels: 3, info: undefined }, painter = new NumberPainter('speed');
  assert.deepEqual([...painter.of(still).coefficients], [0, 0, 0, 0, 0, 0], 'one pose says nothing');
  const moved = { ...still, coefficients: rest.map((value) => value + 1), timeUs: 100_000n };
  for (let again = 0; again < 2; ++again) near([...painter.of(moved).coefficients], [10, 10, 10, 10, 10, 10]);
  assert.deepEqual([...painter.of({ ...still, timeUs: 2_000_000n }).coefficients], [0, 0, 0, 0, 0, 0], 'too far apart');
  const scalar = new NumberPainter('channel:stress');
  scalar.of(pose);
  scalar.include([0, 9]);
  const { title, unit, low, high } = scalar.legend({ colourMap: 'grey' }, { metresPerUnit: 0.001 });
  assert.deepEqual([title, unit, low, high], ['stress', 'MPa', -2, 2], 'what the stream says, in its unit');
});

test('ColourTablesAreThoseOfTheNativeViewer', () => {
  for (const [map, middle] of [['viridis', [0x21, 0x90, 0x8c]], ['coolwarm', [0xdd, 0xdd, 0xdd]], ['grey', [0x86, 0x86, 0x86]]]) {
    const table = tableOf(map);
    assert.equal(table.length, 1024);
    near([...table.subarray(4 * 127, 4 * 127 + 3)], middle, 2);
  }
});

test('RoomsOfHostileBrokersStaySmall', () => {
  const state = new RoomState(), take = (members, more = {}) => state.take({ op: 'room', room: 'a', members, ...more });
  const held = () => [...state.members.values()].reduce((sum, { values }) => sum + JSON.stringify([...values]).length, 0);
  take([], { self: 1, resume: 'x'.repeat(10_000), floors: Array.from({ length: 100 }, (_, i) => ({ floor: `f${i}`, member: 1 })) });
  assert.deepEqual([state.resume.length, state.floors.size], [4096, 8]);
  take([{ id: 1, values: Object.fromEntries(Array.from({ length: 200 }, (_, i) => [`k${i}`, i])) }]);
  assert.equal(state.members.get(1).values.size, 64);
  take([{ id: 2, values: { 'Bad key': 1, ['k'.repeat(33)]: 1, k: 'x'.repeat(2046) } }]);
  assert.deepEqual([...state.members.get(2).values.keys()], ['k']);
  take([{ id: 2, values: { k: 'x'.repeat(2047) } }]);
  assert.equal(state.members.get(2).values.size, 0, 'what was said before is not true any more');
  const much = Object.fromEntries(Array.from({ length: 64 }, (_, i) => [`k${i}`, 'x'.repeat(2000)]));
  for (let id = 3; id < 100; ++id) take([{ id, values: much }]);
  assert.ok(held() < 1 << 20 && held() > 1 << 18, `${held()}`);
  for (let id = 100; id < 5000; ++id) take([{ id }]);
  assert.ok(state.members.size <= 1024);
  take([], { gone: Array.from({ length: 5000 }, (_, id) => id) });
  take(Array.from({ length: 1024 }, (_, id) => ({ id, name: 'P' })));
  assert.equal(state.members.size, 1024, 'room is given back');
  take([{ id: 0, values: { k: 1 } }], { whole: true });
  assert.deepEqual([...state.members.get(0).values], [['k', 1]]);
});

test('RoomsAreFollowedByTheirNews', () => {
  const state = new RoomState();
  state.take({ op: 'room', room: 'a', self: 3, resume: 'secret', speaks: true });
  state.take({ op: 'room', room: 'a', whole: true, members: [{ id: 3, name: 'Ada', colour: '#ff0000' }, { id: 2, name: 'Bob', colour: 'url(evil)', here: false, values: { 'pin.1': [1], x: 0 } }], floors: [{ floor: 'lead', member: 3 }] });
  assert.deepEqual([state.self, state.speaks, state.resume, state.leader.name], [3, true, 'secret', 'Ada']);
  assert.deepEqual([state.members.get(2).here, state.members.get(2).colour], [false, '#808080']);
  state.take({ members: [{ id: 2, here: false, values: { 'pin.1': null } }, { id: 'x' }, null, 7], gone: [3], floors: [{ floor: 'lead', member: 0 }] });
  assert.deepEqual([...state.members.get(2).values.keys()], ['x']);
  assert.equal(state.leader, undefined);
  state.take({ whole: true, members: 'no list', floors: {} });
  assert.equal(state.members.size, 0);
});

test('SurfacePointsOfOthersAreChecked', () => {
  const point = { stream: 'demo', corners: [7, 8, 9], weights: [0.5, 0.25, 0.25], note: 'here' };
  assert.deepEqual(pointFrom(point), point);
  for (const evil of [null, 7, [], { ...point, stream: 7 }, { ...point, corners: [1, 2] }, { ...point, corners: [1, 2, -3] }, { ...point, corners: [1, 2, 0.5] },
    { ...point, corners: [1, 2, 4294967295] }, { ...point, weights: [1, 1, 0] }, { ...point, weights: [2, -1, 0] }, { ...point, weights: ['1', 0, 0] }]) {
    assert.equal(pointFrom(evil), undefined, JSON.stringify(evil));
  }
  assert.equal(pointFrom({ ...point, note: 'x'.repeat(10_000) }).note.length, 500);
  assert.equal(nameFrom('A\nd\u0007a'), 'Ada');
  assert.ok(new TextEncoder().encode(nameFrom('\u{1f600}'.repeat(40))).length <= 64);
});

test('AGroupShowsTheMomentThatTheBrokerSays', () => {
  assert.equal(checkedGroup('op.room-1_a'), 'op.room-1_a');
  for (const wrong of ['', 'A', 'a b', 'x'.repeat(33)]) assert.throws(() => checkedGroup(wrong), { code: 'invalid-argument' });
  const kept = [], sent = [], onText = new Set(), unknown = -(2n ** 63n), broker = { onText, sendText: (text) => sent.push(JSON.parse(text)) };
  let needed = unknown, freed = 0;
  const stream = { name: 'lab/horse', status: {} };
  let settings;
  const playing = inStep({ set: (given) => (settings = given), keepLag: (lag) => (kept.push(lag), needed), at: (nowUs) => nowUs, free: () => ++freed }, broker, stream);
  const moment = (text) => onText.forEach((hear) => hear(text));
  assert.equal(playing.at(3n), 3n);
  stream.status = { clock: { offsetUs: 1_000 } };
  moment('{"op":"moment","stream":"lab/other","lag_us":9}');
  playing.at(3n);
  moment('{"op":"moment","stream":"lab/horse","lag_us":41000}');
  needed = 30_000n;
  playing.at(3n);
  playing.at(3n);
  assert.deepEqual(sent, [{ op: 'late', stream: 'lab/horse', lag_us: 31_000 }], 'on the clock of the broker, not with each picture');
  for (const evil of ['{"op":"moment"', '{"op":"moment","stream":"lab/horse","lag_us":"1"}', '{"op":"moment","stream":"lab/horse"}']) moment(evil);
  playing.at(3n);
  moment('');
  playing.at(3n);
  assert.deepEqual(kept, [unknown, unknown, 40_000n, 40_000n, 40_000n, unknown], 'on our own; none of a connection that is new');
  playing.free();
  assert.deepEqual([freed, onText.size], [1, 0]);
  assert.deepEqual(settings, { mode: 'estimate', smoothness: 1 }, 'a late pose is estimated, and nothing else is hurried');
});

test('AddressesSayBrokerStreamProfileAndCamera', () => {
  const script = 'https://host/behind/v1/web/page.js';
  const place = placeOf(new URL('https://host/behind/lab/horse?rate=raw&embed=1#eye=1,2,3&target=0,0,0.5&access_token=secret'), script);
  assert.deepEqual({ ...place, query: String(place.query) }, { base: 'https://host/behind', stream: 'lab/horse', query: 'rate=raw', token: 'secret', isEmbedded: true, room: '', person: '', eye: [1, 2, 3], target: [0, 0, 0.5] });
  const camera = new Camera();
  assert.equal(linkOf(place, camera), 'https://host/behind/lab/horse?rate=raw', 'nobody has moved the camera');
  camera.lookFrom([1, 2, 3], [0, 0, 0.5]);
  const link = linkOf(place, camera);
  assert.ok(!link.includes('secret'));
  const again = placeOf(new URL(link), script);
  near(again.eye, [1, 2, 3], 1e-4);
  near(again.target, [0, 0, 0.5], 1e-4);
  const inRoom = placeOf(new URL('https://host/behind/lab/horse?rate=raw&room=lab/a%20b&name=Ada'), script);
  assert.deepEqual([inRoom.room, inRoom.person, inRoom.query.toString()], ['lab/a b', 'Ada', 'rate=raw']);
  assert.equal(placeOf(new URL(linkOf(inRoom)), script).room, 'lab/a b', 'a link leads into the room, not in the name of who gives it');
  assert.equal(placeOf(new URL(linkOf(inRoom)), script).person, '');
  assert.equal(placeOf(new URL('https://host/behind/'), script).stream, '');
  assert.equal(placeOf(new URL('https://host/behind/x#eye=1,2'), script).eye, undefined);
});

test('StreamsAreNamedByNameOrUrl', () => {
  const base = 'https://host/behind';
  for (const [text, page] of [
    ['lab/horse', 'https://host/behind/lab/horse'], ['ws://other:7490/lab/horse?rate=raw', 'http://other:7490/lab/horse?rate=raw'], ['wss://other/x', 'https://other/x'],
    ['other:7490/x', 'http://other:7490/x'], ['https://other/x#eye=1,2,3', 'https://other/x#eye=1,2,3'], ['not a name', undefined], ['javascript:alert(1)', undefined],
    ['data:text/html,x', undefined], ['file:///etc/passwd', undefined], ['', undefined], ['v1/web', undefined],
  ]) assert.equal(pageOf(text, base), page, text);
});

test('TilesFillTheWindow', () => {
  for (const [count, width, height] of [[1, 1600, 1000], [30, 800, 500], [100, 1600, 1000], [100, 390, 844], [7, 1920, 1080]]) {
    const tile = tileWidth(count, width, height), columns = Math.floor(width / tile);
    assert.ok(tile > 0 && Math.ceil(count / columns) * (tile / 1.6) <= height, `${count} in ${width} x ${height}: ${tile}`);
  }
  assert.equal(tileWidth(100, 1600, 1000), 160);
  assert.equal(tileWidth(0, 1600, 1000), 0);
});

test('WordsAreThoseOfTheNativeClient', () => {
  const status = { state: 'stalled', detail: '' };
  assert.equal(bannerOf(status, 1000, 4100), 'no data for 3.1 s - the sender is gone, this is its last pose');
  assert.equal(bannerOf({ ...status, state: 'lost', detail: 'connection to x lost' }, 1000, 1500), 'no data for 0.5 s - connection lost: connection to x lost');
  assert.equal(bannerOf({ ...status, state: 'live' }, 1000, 9000), '');
  assert.equal(bannerOf(status, undefined, 9000), '', 'nothing was shown yet');
  const profile = { rate: 'interpolated', k: 3, scheme: 'linear', bands: 8 };
  assert.equal(textFromMode(profile), 'interpolated x3');
  assert.equal(textFromMode({ ...profile, rate: 'estimated', scheme: 'damped' }), 'estimated x3 damped');
  const lines = figureLines({
    keysHz: 30, posesHz: 90, drawnHz: 59.9, kbitPerS: 412, roundTripMs: 3.24, vertices: 4096, verticesTotal: 42321, faces: 8190, profile, shown: 'interpolated',
    utcUs: -1_000n, delayMs: 12, workMs: 3.2, load: 0.4, bands: 3, bandsTotal: 4, rank: 200,
  });
  assert.equal(lines[0], '30 keys/s · 90 poses/s · 60 drawn/s');
  assert.match(lines[4], /12 ms held back · 23:59:59.999$/);
  assert.equal(timecodeOf(86_400_000_000n * 3n + 3_723_004_000n), '01:02:03.004');
  assert.equal(utcOf({ utc_us: 100n }, 7n), 107n);
  assert.equal(utcOf({ utc_us: 100n, rewind: { at_us: 1n, capture_us: 10n, speed: 0.5 } }, 14n), 112n);
  assert.equal(lines[2], 'LOD 0.10 · 4,096 of 42,321 vertices, 8,190 faces');
});

test('StreamsOfOneClockAreComparedByCaptureTimes', () => {
  const pose = (f, clockUs, wayUs, epoch = 1) => ({ epoch, captureUs: BigInt(clockUs + 32_000 * f), arrivalUs: clockUs + 32_000 * f + wayUs, channels: 4, coefficients: Float64Array.of(f, 0, 0, 9, 0, f, 0, 9) });
  const [first, second, elsewhere] = [new History(), new History(), new History()];
  assert.equal(second.at(0), undefined);
  for (let f = 0; f < 8; ++f) first.add(pose(f, 1e6, 1000)), second.add(pose(f, 1e6, 9000)), elsewhere.add(pose(f, 777e6, 1000 - 776e6));
  assert.deepEqual([...positionsOf(pose(3, 0, 0))], [3, 0, 0, 0, 3, 0]);
  assert.equal(otherTime(1_064_000, first, second), 1_064_000);
  assert.equal(otherTime(1_064_000, first, elsewhere), 777_064_000);
  near([...second.at(1_080_000)], [2.5, 0, 0, 0, 2.5, 0]);
  near([...elsewhere.at(otherTime(1_064_000, first, elsewhere))], [2, 0, 0, 0, 2, 0]);
  const squares = new History();
  for (let f = 0; f < 8; ++f) squares.add({ ...pose(f, 1e6, 1000), coefficients: Float64Array.of(f * f, 0, 0, 9) });
  for (const f of [0.5, 2.5, 6.25]) near([squares.at(1e6 + 32_000 * f)[0]], [f * f]);
  near([second.at(0)[0], second.at(9e9)[0]], [0, 7]);
  second.add(pose(0, 5e6, 1000, 2));
  near([second.at(0)[0], second.at(9e9)[0]], [0, 0], 0);
});

test('ADifferenceIsThatOfCoefficients', () => {
  const painter = new NumberPainter('difference'), pose = { coefficients: Float64Array.of(1, 2, 3, 9, 4, 5, 6, 9), channels: 4, rest: new Float64Array(6), timeUs: 0n, info: undefined };
  const live = { other: () => Float64Array.of(1, 2, 2, 4, 3, 6) };
  assert.deepEqual(painter.of({ ...pose, live }), { coefficients: Float64Array.of(0, 0, 1, 0, 2, 0), isLength: true });
  assert.equal(painter.of({ ...pose, live: { other: () => undefined } }), undefined);
});
