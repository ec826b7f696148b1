// SPDX-License-Identifier: MIT
//
// soak.mjs [MINUTES]: the page for so many minutes (30) with cut connections, hidden tabs, lost GL contexts, restarted senders and brokers. Prints the
// memory of the page each minute; ends with 1 where it does not come back to life, or where memory grows after the first third.
import { Programs } from '../system/programs.mjs';
import { startChromium } from './chromium.mjs';
import { hasState } from './looks.mjs';
import { startSite } from './site.mjs';

const minutes = Number(process.argv[2] ?? 30), end = Date.now() + 60_000 * minutes, GROWTH = 1.25;
const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
const programs = new Programs();
let broker = await programs.broker(), sender = programs.sender(broker, 'lab/heart', 'heart', '--rank', '24');
const site = await startSite(broker.port), chromium = await startChromium(), tab = await chromium.tab();
await tab.size(480, 300);
await tab.preload(`
  const getContext = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, ...more) { const made = getContext.call(this, kind, ...more); if (/webgl/.test(kind)) window.gl = made; return made; };`);
await tab.open(`${site.url}/lab/heart`);
const hide = (isHidden) => tab.evaluate(`Object.defineProperty(document, 'hidden', { configurable: true, get: () => ${isHidden} }); document.dispatchEvent(new Event('visibilitychange'))`);
const TROUBLES = {
  cut: () => site.cut(),
  async hidden() {
    await hide(true);
    await sleep(3000);
    await hide(false);
  },
  async context() {
    await tab.evaluate("(window.loser ??= gl.getExtension('WEBGL_lose_context')).loseContext()");
    await sleep(300);
    await tab.evaluate('loser.restoreContext()');
  },
  async sender() {
    await sender.stop('SIGKILL');
    sender = programs.sender(broker, 'lab/heart', 'heart', '--rank', '24');
  },
  async broker() {
    await broker.stop('SIGKILL');
    broker = await programs.broker(broker.port);
  },
};
/** Live, and other pictures than before. */
async function lives() {
  const print = "document.querySelector('canvas').getContext('2d').getImageData(0, 0, 480, 300).data.reduce((n, byte) => (31 * n + byte) | 0, 0)";
  await tab.until(hasState('live'), 300_000);
  await sleep(1000);  // Its colours have come back.
  const before = await tab.evaluate(print);
  await tab.until(`${print} !== ${before}`, 300_000);
}
const heaps = [];
let rounds = 0, toldMs = 0;
try {
  await lives();
  while (Date.now() < end) {
    for (const [name, trouble] of Object.entries(TROUBLES)) {
      await trouble();
      await lives().catch((error) => {
        throw new Error(`after ${name}, round ${rounds}: ${error.message}`);
      });
    }
    ++rounds;
    if (Date.now() - toldMs < 60_000) continue;
    toldMs = Date.now();
    await tab.send('HeapProfiler.collectGarbage', {});
    await tab.send('Performance.enable', {});
    const metrics = Object.fromEntries((await tab.send('Performance.getMetrics', {})).metrics.map(({ name, value }) => [name, value]));
    heaps.push(metrics.JSHeapUsedSize);
    console.log(`${rounds} rounds: heap ${(metrics.JSHeapUsedSize / 1e6).toFixed(2)} MB, ${metrics.Nodes} nodes, ${metrics.JSEventListeners} listeners`);
  }
  const third = heaps[Math.floor(heaps.length / 3)], last = heaps.at(-1);
  console.log(`${rounds} rounds of ${Object.keys(TROUBLES).join(', ')}: heap ${(third / 1e6).toFixed(2)} to ${(last / 1e6).toFixed(2)} MB`);
  process.exitCode = last > GROWTH * third ? 1 : 0;
} finally {
  await chromium.stop();
  await site.stop();
  programs.stop();
}
