// SPDX-License-Identifier: MIT
//
// figures.mjs URL [LOADS] [WIDTH x HEIGHT]: how long the page at URL, which a site of this folder or a broker serves, takes to the
// first picture of its surface, each time with an empty cache; and, for five seconds, what its main thread works for a picture.
import { startChromium } from './chromium.mjs';

const [, , url, loads = '20', size = '960x600'] = process.argv;
const at = (values, part) => values.sort((a, b) => a - b)[Math.min(values.length - 1, Math.floor(part * values.length))];
const chromium = await startChromium();
const firsts = [];
// Of the page, from its navigation on: the first clay.
const WATCH = `(() => {
  const look = () => {
    const from = document.querySelector('canvas');
    if (from && from.width > 1) {
      const to = document.createElement('canvas').getContext('2d', { willReadFrequently: true });
      to.canvas.width = 64; to.canvas.height = 40;
      to.drawImage(from, 0, 0, 64, 40);
      const data = to.getImageData(0, 0, 64, 40).data;
      for (let i = 0; i < data.length; i += 4) if (data[i] > data[i + 2] + 60) return (window.firstPicture = performance.now());
    }
    requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
})()`;
for (let load = 0; load < Number(loads); ++load) {
  const tab = await chromium.tab();
  await tab.size(...size.split('x').map(Number));
  await tab.send('Network.enable', {});
  await tab.send('Network.setCacheDisabled', { cacheDisabled: true });
  await tab.send('Page.addScriptToEvaluateOnNewDocument', { source: WATCH });
  await tab.open(url);
  firsts.push(await tab.until('window.firstPicture'));
  if (load === Number(loads) - 1) {
    await new Promise((resolve) => setTimeout(resolve, 3000));
    await tab.send('Performance.enable', {});
    const metric = async (name) => (await tab.send('Performance.getMetrics', {})).metrics.find((one) => one.name === name).value;
    const before = await metric('ScriptDuration');
    const frames = await tab.evaluate('new Promise((resolve) => { let n = 0; const end = performance.now() + 5000; const next = () => { ++n; if (performance.now() > end) resolve(n); else requestAnimationFrame(next); }; requestAnimationFrame(next); })');
    console.log(`main thread: ${((1000 * (await metric('ScriptDuration') - before)) / frames).toFixed(2)} ms of scripts a turn of the display, ${(frames / 5).toFixed(0)} turns/s; heap ${(await metric('JSHeapUsedSize') / 1e6).toFixed(1)} MB`);
  }
  await tab.close();
}
console.log(`first picture of ${loads} loads: p50 ${at(firsts, 0.5).toFixed(0)} ms, p95 ${at(firsts, 0.95).toFixed(0)} ms, least ${Math.min(...firsts).toFixed(0)} ms`);
await chromium.stop();
