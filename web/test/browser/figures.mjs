// SPDX-License-Identifier: MIT
//
// figures.mjs [WHAT...]: the figures of docs/performance/web.md that take a browser (first, link, horses, hidden, phone, wall, firefox, recording, past: all of them). The horse
// gallops from EIGENCAST_DATA_DIR; EIGENCAST_BIN, EIGENCAST_WEB_BUILD; LOADS: of a page, each with a profile of its own (20).
import { spawnSync } from 'node:child_process';
import { existsSync, readFileSync, readdirSync, statSync } from 'node:fs';
import { createServer } from 'node:http';
import { join } from 'node:path';
import { fileURLToPath, pathToFileURL } from 'node:url';
import { BIN, Programs } from '../system/programs.mjs';
import { until } from '../unit/fake_broker.mjs';
import { startChromium } from './chromium.mjs';
import { startFirefox } from './firefox.mjs';
import { PRINT, hasState } from './looks.mjs';

const wanted = process.argv.length > 2 ? process.argv.slice(2) : ['first', 'link', 'horses', 'hidden', 'phone', 'wall', 'firefox', 'recording', 'past'];
const LOADS = Number(process.env.LOADS ?? 20), SWIFTSHADER = ['--use-angle=swiftshader', '--enable-unsafe-swiftshader'];
const HORSE = join(process.env.EIGENCAST_DATA_DIR ?? '', 'animations/horse-gallop');
const part = (values, of) => [...values].sort((a, b) => a - b)[Math.min(values.length - 1, Math.floor(of * values.length))];
const said = (values) => `p50 ${part(values, 0.5).toFixed(0)}, p95 ${part(values, 0.95).toFixed(0)}, least ${Math.min(...values).toFixed(0)} ms`;
const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

// Of the page, from its navigation on: when the first pixels of its surface are there, and when all of the surface is.
// A surface's faces must have been drawn before pixels are read, for reading waits for the GPU and so holds the page up.
const WATCH = `(() => {
  const context = WebGL2RenderingContext.prototype, drawElements = context.drawElements;
  let isDrawn = false;
  context.drawElements = function (mode, count, ...more) {
    isDrawn ||= count > 3;
    return drawElements.call(this, mode, count, ...more);
  };
  const look = () => {
    const from = document.querySelector('canvas');
    if (!window.firstPicture && isDrawn && from && from.width > 1) {
      const to = document.createElement('canvas').getContext('2d', { willReadFrequently: true });
      [to.canvas.width, to.canvas.height] = [64, 40];
      to.drawImage(from, 0, 0, 64, 40);
      const data = to.getImageData(0, 0, 64, 40).data;
      for (let i = 0; i < data.length; i += 4) if (data[i] > data[i + 2] + 60) { window.firstPicture = performance.now(); break; }
    }
    // Notices of the broker may stand there instead of 'live'.
    if (window.firstPicture && !/^$|connect|download|late/.test(document.querySelector('.state')?.title ?? '')) return (window.complete = performance.now());
    requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
})()`;

/** What the browser itself takes: a page whose picture is a GL canvas that was cleared. */
const EMPTY = `<!doctype html><title>empty</title><canvas width="960" height="600"></canvas><script>
  const to = document.querySelector('canvas').getContext('2d'), gl = document.createElement('canvas').getContext('webgl2');
  gl.clearColor(1, 0, 0, 1);
  gl.clear(gl.COLOR_BUFFER_BIT);
  to.drawImage(gl.canvas, 0, 0);
  requestAnimationFrame(() => { if (to.getImageData(0, 0, 1, 1).data[0] > 200) window.firstPicture = window.complete = performance.now(); });
</script>`;

/** Loads of `url`, each in a browser of its own: milliseconds to the first picture, and to the whole surface. */
async function loads(url, count, { start = startChromium, size = [960, 600], slower = 1, screen = {} } = {}) {
  const first = [], complete = [];
  for (let load = 0; load < count; ++load) {
    const browser = await start(), tab = await browser.tab();
    await tab.size(...size, screen);
    if (slower > 1) await tab.send('Emulation.setCPUThrottlingRate', { rate: slower });
    await tab.preload(WATCH);
    await browser.settled?.();
    await tab.open(url);
    complete.push(await tab.until('window.complete', 120_000));
    first.push(await tab.evaluate('window.firstPicture'));
    await browser.stop();
  }
  return { first, complete };
}
/** For `seconds`: milliseconds of scripts a turn of the display on the main thread, and turns a second. */
async function mainThread(tab, seconds) {
  await tab.send('Performance.enable', {});
  const spent = async () => (await tab.send('Performance.getMetrics', {})).metrics.find(({ name }) => name === 'ScriptDuration').value;
  const before = await spent();
  const turns = await tab.evaluate(`new Promise((resolve) => { let n = 0; const end = performance.now() + ${1000 * seconds}; const next = () => { ++n; if (performance.now() > end) resolve(n); else requestAnimationFrame(next); }; requestAnimationFrame(next); })`);
  return `${((1000 * (await spent() - before)) / turns).toFixed(2)} ms of scripts a turn of the display, ${(turns / seconds).toFixed(0)} turns/s`;
}

/** Of 200 places of a timeline: milliseconds until another picture is there. */
const seeks = (tab) => tab.evaluate(`(async () => {
  const bar = document.querySelector('.timeline input'), all = [];
  for (let i = 0; i < 200; ++i) {
    const before = ${PRINT}, from = performance.now();
    bar.value = (Number(bar.max) * ((7919 * i) % 200)) / 200;
    bar.dispatchEvent(new Event('input'));
    while (${PRINT} === before && performance.now() - from < 3000) await new Promise((resolve) => setTimeout(resolve, 1));
    all.push(performance.now() - from);
  }
  return all;
})()`);

const programs = new Programs();
const FIGURES = {
  async first(url) {
    const server = createServer((_, answer) => answer.setHeader('Content-Type', 'text/html').end(EMPTY)), first = [], empty = [];
    await new Promise((resolve) => server.listen(0, '127.0.0.1', resolve));
    for (let load = 0; load < LOADS; ++load) {
      first.push(...(await loads(url, 1)).first);
      empty.push(...(await loads(`http://127.0.0.1:${server.address().port}/`, 1)).first);
    }
    server.close();
    console.log(`first picture, loopback, ${LOADS} fresh profiles: ${said(first)}; an empty page with a GL canvas: ${said(empty)}`);
    const chromium = await startChromium(), tab = await chromium.tab();
    await tab.size(960, 600);
    await tab.open(url);
    await tab.until(hasState('live'), 60_000);
    await sleep(3000);
    console.log(`main thread: ${await mainThread(tab, 5)}`);
    await chromium.stop();
  },
  async link(url, broker) {
    const file = join(programs.folder, 'relay'), count = Math.max(3, Math.round(LOADS / 4));
    const relay = programs.start('eigencast-impaired-relay', '--to', String(broker.port), '--delay-ms', '25', '--rate-kbit', '10000', '--port-file', file);
    const port = await until(() => existsSync(file) && readFileSync(file, 'utf8').trim(), 'the relay');
    const { first, complete } = await loads(url.replace(`:${broker.port}/`, `:${port}/`), count);
    console.log(`10 Mbit/s, 50 ms round trip, ${count} fresh profiles: first picture ${said(first)}; complete ${said(complete)}`);
    await relay.stop();
  },
  /** As bench/paper/figure_6_7.py: 20 pictures a second wanted, in time within 1.25 of their time. */
  async horses(url) {
    const chromium = await startChromium(...SWIFTSHADER), tab = await chromium.tab(), origin = new URL(url).origin;
    await tab.size(640, 300);
    await tab.open(`${origin}/`);
    await tab.until("document.querySelector('.streams')");
    const web = await tab.evaluate("document.querySelector('script[type=module]').src.replace(/page\\.js$/, '')");
    await tab.evaluate(`(async () => {
      const [{ connect }, { Stage, View }] = await Promise.all([import('${web}eigencast.js'), import('${web}view.js')]);
      document.body.replaceChildren();
      const stage = await Stage.make((await connect(location.origin)).module, { picturesPerSecond: 20 });
      window.views = [];
      for (let i = 0; i < 6; ++i) {
        const canvas = document.body.appendChild(document.createElement('canvas')), broker = await connect(location.origin);
        canvas.style.cssText = 'width: 192px; height: 108px';
        views.push(new View(stage, canvas, broker.watch('lab/horse')));
      }
    })()`);
    await tab.until('views.every(({ live }) => live.surface?.isComplete && live.shownUs !== undefined)', 120_000);
    await sleep(3000);
    const times = await tab.evaluate(`new Promise((resolve) => {
      const seen = views.map(({ drawn }) => ({ drawn, at: performance.now() })), all = [], end = performance.now() + 10000;
      const look = () => {
        const now = performance.now();
        views.forEach(({ drawn }, i) => { if (drawn !== seen[i].drawn) { all.push(now - seen[i].at); seen[i] = { drawn, at: now }; } });
        if (now > end) resolve(all); else setTimeout(look, 2);
      };
      look();
    })`);
    console.log(`six horses, 192 x 108, SwiftShader: ${((100 * times.filter((ms) => ms <= 62.5).length) / times.length).toFixed(1)} % of pictures within 62.5 ms, ${(times.length / 60).toFixed(1)} pictures/s each, ${await tab.evaluate('Math.round(views.reduce((sum, { vertices }) => sum + vertices, 0) / 6)')} vertices each`);
    await chromium.stop();
  },
  async hidden(url) {
    const chromium = await startChromium(), tab = await chromium.tab();
    await tab.size(480, 300);
    await tab.open(url);
    await tab.until(hasState('live'), 60_000);
    await sleep(2000);
    const print = "document.querySelector('canvas').getContext('2d').getImageData(0, 0, document.querySelector('canvas').width, document.querySelector('canvas').height).data.reduce((n, byte) => (31 * n + byte) | 0, 0)";
    const back = [];
    for (let round = 0; round < 5; ++round) {
      await tab.evaluate("Object.defineProperty(document, 'hidden', { configurable: true, get: () => true }); document.dispatchEvent(new Event('visibilitychange'))");
      await sleep(3000);
      back.push(await tab.evaluate(`new Promise((resolve) => {
        const before = ${print}, from = performance.now();
        Object.defineProperty(document, 'hidden', { configurable: true, get: () => false });
        document.dispatchEvent(new Event('visibilitychange'));
        const look = () => (${print} !== before ? resolve(performance.now() - from) : setTimeout(look, 5));
        look();
      })`));
      await sleep(1000);
    }
    console.log(`hidden tab: back to moving ${said(back)} (no frames while hidden: test HiddenPagesTakeNoPoses)`);
    await chromium.stop();
  },
  async phone(url) {
    const screen = { scale: 3, mobile: true }, { first } = await loads(url, Math.max(3, Math.round(LOADS / 4)), { size: [390, 844], slower: 4, screen });
    const chromium = await startChromium(), tab = await chromium.tab();
    await tab.size(390, 844, screen);
    await tab.send('Emulation.setTouchEmulationEnabled', { enabled: true });
    await tab.send('Emulation.setCPUThrottlingRate', { rate: 4 });
    await tab.open(url);
    await tab.until(hasState('live'), 60_000);
    await sleep(3000);
    console.log(`phone (390 x 844, a quarter of the processor): first picture ${said(first)}; main thread: ${await mainThread(tab, 5)}`);
    await chromium.stop();
  },
  async firefox(url) {
    const count = Math.max(3, Math.round(LOADS / 4)), { first, complete } = await loads(url, count, { start: startFirefox });
    console.log(`Firefox, loopback, ${count} fresh profiles: first picture ${said(first)}; complete ${said(complete)}`);
  },
  /** An hour of the horse in one file: how large, how soon it plays, and how soon the picture of any other time is there. */
  async recording() {
    const recorder = await programs.broker(0, '--recording-streams=**', '--recording-include-asset=true');
    await programs.sender(recorder, 'horse', HORSE, '--frames', '1350').ended;
    await recorder.stop();
    const folder = readdirSync(programs.folder).map((name) => join(programs.folder, name, 'recordings')).find((path) => existsSync(path) && readdirSync(path).length > 0);
    const part45s = join(folder, readdirSync(folder)[0]), hour = join(programs.folder, 'hour.ecrec'), page = join(programs.folder, 'hour.html');
    for (const words of [['cut', ...Array(80).fill(part45s), '--to', hour], ['export', hour, '--to', page, '--no-progress']])
      spawnSync(join(BIN, 'eigencast-sender'), words, { stdio: ['ignore', 'ignore', 'inherit'] });
    const chromium = await startChromium(), tab = await chromium.tab(), begun = Date.now();
    await tab.size(320, 200);
    await tab.open(pathToFileURL(page).href);
    await tab.until("Number(document.querySelector('.timeline input').value) > 0");
    const opened = Date.now() - begun;
    await tab.evaluate("document.querySelector('.timeline button').click()");
    await sleep(500);
    const sought = await seeks(tab);
    console.log(`an hour of the horse: ${(statSync(page).size / 1e6).toFixed(1)} MB (recording ${(statSync(hour).size / 1e6).toFixed(1)}), plays after ${opened} ms; 200 positions: ${said(sought)}`);
    await chromium.stop();
  },
  /** What a broker keeps of the last minute. */
  async past() {
    const broker = await programs.broker(0, '--history-streams=**'), chromium = await startChromium(), tab = await chromium.tab();
    programs.sender(broker, 'lab/horse', HORSE);
    await tab.size(320, 200);
    await tab.open(`http://127.0.0.1:${broker.port}/lab/horse`);
    await tab.until("Number(document.querySelector('.timeline input')?.max) > 60", 300_000);
    await tab.evaluate("document.querySelector('.timeline button').click()");
    await sleep(500);
    console.log(`the last minute of the horse: 200 positions: ${said(await seeks(tab))}`);
    await chromium.stop();
    await broker.stop();
  },
  async wall() {
    for (const motion of ['heart', HORSE])
      console.log(spawnSync(process.execPath, [fileURLToPath(new URL('wall.mjs', import.meta.url)), '100', '15', '1600x1000', motion], { encoding: 'utf8' }).stdout.trim());
  },
};

try {
  const broker = await programs.broker(), url = `http://127.0.0.1:${broker.port}/lab/horse`;
  programs.sender(broker, 'lab/horse', HORSE);
  await until(async () => (await (await fetch(`http://127.0.0.1:${broker.port}/v1/streams`)).json()).streams.some(({ state }) => state === 'live'), 'the horse', 300_000);
  for (const what of wanted) await FIGURES[what](url, broker);
} finally {
  programs.stop();
}
