// SPDX-License-Identifier: MIT
//
// A stream that learns columns, in Chromium: a real broker, sender and native viewer (EIGENCAST_BIN).
import assert from 'node:assert/strict';
import { existsSync, readFileSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { test } from 'node:test';
import { Programs } from '../system/programs.mjs';
import { until } from '../unit/fake_broker.mjs';
import { CHROMIUM, startChromium } from './chromium.mjs';
import { CLAY, hasState } from './looks.mjs';

if (!CHROMIUM) {
  console.log('no Chromium: deploy/install-packages.sh full');
  process.exit(77);
}

const PICTURES = process.env.EIGENCAST_PICTURES, LIMIT_MS = 150_000, RANK = 40;
const WATCH = `import('/v1/web/eigencast.js').then(async ({ watch }) => {
  globalThis.seen = [];
  const stream = await watch(location.origin + '/lab/tube?rate=raw');
  stream.on('pose', ({ epoch, sequence, coefficients }) => seen.push([epoch, String(sequence), Array.from(coefficients)]));
})`;

test('PosesOfAStreamThatLearnsAreThoseOfTheNativeViewer', async (t) => {
  const programs = new Programs(), record = join(programs.folder, 'record');
  t.after(() => programs.stop());
  const broker = await programs.broker(0, '--frames-ladder=false'), url = `http://127.0.0.1:${broker.port}/lab/tube?rate=raw`;
  const chromium = await startChromium();
  t.after(() => chromium.stop());
  const tab = await chromium.tab();
  await tab.size(480, 300);
  programs.start('eigencast-client', url, '--headless', '--size', '16x16', '--duration', '600', '--wait', '150', '--record', record, '--cache', '');
  const sender = programs.tube(broker, 'lab/tube');
  await tab.open(url);
  await tab.until(`${hasState('live')} && ${CLAY} > 100`, LIMIT_MS);
  await tab.evaluate(WATCH);
  await tab.until(`seen.filter(([, , C]) => C.length > ${3 * RANK}).length >= 30`, LIMIT_MS);
  await tab.until(`${hasState('live')} && ${CLAY} > 100`, LIMIT_MS);
  if (PICTURES) writeFileSync(join(PICTURES, 'learn.png'), await tab.screenshot());
  const seen = await tab.evaluate('seen');
  await sender.stop();
  const [epoch, sequence] = seen.at(-1);
  const native = () => (existsSync(record) ? readFileSync(record, 'utf8').split('\n').slice(0, -1).map((line) => JSON.parse(line)) : []);
  await until(() => native().some((pose) => pose.epoch > epoch || (pose.epoch === epoch && pose.sequence >= Number(sequence))), 'the native viewer');
  const known = new Map(native().map((pose) => [`${pose.epoch} ${pose.sequence}`, pose.coefficients]));
  const both = seen.filter(([epoch, sequence]) => known.has(`${epoch} ${sequence}`)), wider = both.filter(([, , C]) => C.length > 3 * RANK);
  for (const [epoch, sequence, coefficients] of both) assert.deepEqual(coefficients, known.get(`${epoch} ${sequence}`), `${epoch} ${sequence}`);
  assert.ok(both.length > wider.length && wider.length > 10, `${both.length} poses that both have, ${wider.length} of them with columns`);
  assert.ok(wider.some(([, , C]) => C.slice(3 * RANK).some((value) => value !== 0)), 'columns that move');
  assert.deepEqual([new Set(both.map(([epoch]) => epoch)).size, tab.console], [2, []]);
});
