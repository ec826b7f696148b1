// SPDX-License-Identifier: MIT
//
// wall.mjs [STREAMS] [SECONDS] [WIDTHxHEIGHT] [MOTION...]: a wall of so many streams (100) in Chromium, each with its moment of MOTION, an input of
// `eigencast-sender play` (heart), at 30 keys/s: connections, GL contexts, bytes at the socket, poses and pictures of the slowest stream.
import { pathToFileURL } from 'node:url';
import { Programs } from '../system/programs.mjs';
import { environment, until } from '../unit/fake_broker.mjs';
import { internals, wasm, writerWasm } from '../unit/support.mjs';
import { startChromium } from './chromium.mjs';
import { startSite } from './site.mjs';

const { publish, watch } = internals, options = { core: wasm, worker: false, environment };

/** Publishes `count` streams wall/0, ... at `broker`: poses of the first one's sender, each with a delay of its own. */
export async function publishWall(programs, broker, count, ...motion) {
  programs.sender(broker, 'wall/0', ...motion);
  const url = (i) => `http://127.0.0.1:${broker.port}/wall/${i}`, source = await watch(`${url(0)}?rate=raw`, options), poses = [];
  await until(() => source.pose && source.surface?.isComplete, 'the first pose', 150_000);
  const publishers = await Promise.all(Array.from({ length: count - 1 }, (_, i) => publish(url(i + 1), { ...options, writer: writerWasm, asset: source.surface.asset })));
  source.on('pose', ({ coefficients }) => {
    poses.push(coefficients);
    if (poses.length > 300) poses.shift();
    publishers.forEach((publisher, i) => publisher.send(poses.at(-1 - ((7 * i) % poses.length))));
  });
  return () => {
    source.close();
    for (const publisher of publishers) publisher.close();
  };
}

/** For Page.addScriptToEvaluateOnNewDocument: counts GL contexts, and pictures of each canvas. */
export const COUNTS = `
  window.contexts = 0;
  const getContext = HTMLCanvasElement.prototype.getContext, drawImage = CanvasRenderingContext2D.prototype.drawImage;
  HTMLCanvasElement.prototype.getContext = function (kind, ...more) { if (/webgl/.test(kind)) ++window.contexts; return getContext.call(this, kind, ...more); };
  CanvasRenderingContext2D.prototype.drawImage = function (...words) { this.canvas.pictures = (this.canvas.pictures ?? 0) + 1; return drawImage.apply(this, words); };
  window.pictures = () => [...document.querySelectorAll('.streams canvas')].map((one) => one.pictures ?? 0);`;

if (process.argv[1] && import.meta.url === pathToFileURL(process.argv[1]).href) {
  const [, , count = '100', seconds = '20', size = '1600x1000', ...motion] = process.argv;
  const programs = new Programs(), broker = await programs.broker();
  const stop = await publishWall(programs, broker, Number(count), ...(motion.length > 0 ? motion : ['heart'])), site = await startSite(broker.port), chromium = await startChromium();
  const tab = await chromium.tab();
  await tab.size(...size.split('x').map(Number));
  await tab.preload(COUNTS);
  await tab.open(`${site.url}/?wall=1`);
  await tab.until(`pictures().length === ${count} && pictures().every((n) => n > 1)`, 120_000);
  await new Promise((resolve) => setTimeout(resolve, 3000));
  const before = { ...site.counted, pictures: await tab.evaluate('pictures()'), at: Date.now() };
  await new Promise((resolve) => setTimeout(resolve, 1000 * Number(seconds)));
  const after = await tab.evaluate('pictures()'), s = (Date.now() - before.at) / 1000;
  const rates = after.map((n, i) => (n - before.pictures[i]) / s).sort((a, b) => a - b), mbit = (name) => ((8 * (site.counted[name] - before[name])) / s / 1e6).toFixed(2);
  console.log(`${count} streams, ${site.counted.connections} connections, ${await tab.evaluate('contexts')} GL contexts, ${await tab.evaluate("document.querySelector('.streams canvas').width + ' x ' + document.querySelector('.streams canvas').height")} each`);
  console.log(`down ${mbit('bytesDown')} Mbit/s, up ${mbit('bytesUp')} Mbit/s; pictures a second of a stream: least ${rates[0].toFixed(1)}, median ${rates[rates.length >> 1].toFixed(1)}`);
  if (process.env.EIGENCAST_PICTURES) (await import('node:fs')).writeFileSync(`${process.env.EIGENCAST_PICTURES}/wall.png`, await tab.screenshot());
  console.log(tab.console.join('\n'));
  await chromium.stop();
  stop();
  await site.stop();
  programs.stop();
}
