// SPDX-License-Identifier: MIT
//
// Chromium by its DevTools protocol, over pipes: no port, no module.
import { spawn } from 'node:child_process';
import { existsSync, mkdtempSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { until } from './screen.mjs';

export const CHROMIUM = process.env.EIGENCAST_CHROMIUM ?? ['/usr/bin/chromium', '/usr/bin/chromium-browser', '/usr/bin/google-chrome'].find(existsSync);
/** llvmpipe, which is quicker than Chromium's SwiftShader. */
const SOFTWARE = ['--use-gl=angle', '--use-angle=gl-egl', '--ignore-gpu-blocklist'];

/** Messages are ended by zeros. */
class Pipe {
  #write;
  #rest = '';
  #ids = 0;
  #waiting = new Map();
  onEvent = () => {};

  constructor(write, read) {
    this.#write = write;
    write.on('error', () => {});
    read.setEncoding('utf8').on('data', (text) => {
      const [rest, ...whole] = (this.#rest + text).split('\0').reverse();
      this.#rest = rest;
      for (const one of whole.reverse()) this.#take(JSON.parse(one));
    });
  }
  send(method, params = {}, sessionId = undefined) {
    const id = ++this.#ids;
    this.#write.write(`${JSON.stringify({ id, method, params, sessionId })}\0`);
    return new Promise((resolve, reject) => this.#waiting.set(id, { resolve, reject, method }));
  }
  #take({ id, result, error, ...event }) {
    if (id === undefined) return this.onEvent(event);
    const { resolve, reject, method } = this.#waiting.get(id);
    this.#waiting.delete(id);
    if (error) reject(new Error(`${method}: ${error.message}`));
    else resolve(result);
  }
}

/** Of keys that the browser itself acts on. */
const CODES = { Tab: 9, Enter: 13, Escape: 27 };

/** A tab. */
class Tab {
  /** What the page wrote to its console, exceptions among it. */
  console = [];
  #pipe;
  #session;
  target;

  constructor(pipe, session, target) {
    this.#pipe = pipe;
    this.#session = session;
    this.target = target;
  }
  send(method, params) {
    return this.#pipe.send(method, params, this.#session);
  }
  take({ method, params }) {
    if (method === 'Runtime.consoleAPICalled') this.console.push(`${params.type}: ${params.args.map((one) => one.value ?? one.description).join(' ')}`);
    if (method === 'Runtime.exceptionThrown') this.console.push(`exception: ${params.exceptionDetails.exception?.description ?? params.exceptionDetails.text}`);
    if (method === 'Log.entryAdded') this.console.push(`${params.entry.level}: ${params.entry.text} ${params.entry.url ?? ''}`);
  }
  async open(url) {
    await this.send('Page.navigate', { url });
  }
  /** Of an expression, awaited. */
  async evaluate(expression) {
    const { result, exceptionDetails } = await this.send('Runtime.evaluate', { expression, awaitPromise: true, returnByValue: true, userGesture: true });
    if (exceptionDetails) throw new Error(exceptionDetails.exception?.description ?? exceptionDetails.text);
    return result.value;
  }
  until(expression, limitMs) {
    return until(this, expression, limitMs);
  }
  /** Before the scripts of each page that is opened from now on. */
  async preload(source) {
    await this.send('Page.addScriptToEvaluateOnNewDocument', { source });
  }
  async screenshot() {
    const { data } = await this.send('Page.captureScreenshot', { format: 'png' });
    return Buffer.from(data, 'base64');
  }
  async key(key, modifiers = 0) {
    const text = key.length === 1 ? key : key === 'Enter' ? '\r' : undefined;
    for (const type of ['keyDown', 'keyUp']) await this.send('Input.dispatchKeyEvent', { type, key, modifiers, ...(CODES[key] ? { windowsVirtualKeyCode: CODES[key] } : {}), ...(type === 'keyDown' && text ? { text } : {}) });
  }
  async mouse(type, x, y, more = {}) {
    await this.send('Input.dispatchMouseEvent', { type, x, y, button: 'none', ...more });
  }
  /** Points: where fingers are. */
  async touch(type, ...points) {
    await this.send('Input.dispatchTouchEvent', { type, touchPoints: points.map(([x, y], id) => ({ x, y, id })) });
  }
  async size(width, height, { scale = 1, mobile = false } = {}) {
    await this.send('Emulation.setDeviceMetricsOverride', { width, height, deviceScaleFactor: scale, mobile });
  }
  /** Such as {'prefers-color-scheme': 'dark'}. */
  async media(features) {
    await this.send('Emulation.setEmulatedMedia', { features: Object.entries(features).map(([name, value]) => ({ name, value })) });
  }
  async close() {
    await this.#pipe.send('Target.closeTarget', { targetId: this.target });
  }
}

/** Headless, with WebGL on the processor. */
export async function startChromium(...more) {
  const profile = mkdtempSync(join(tmpdir(), 'eigencast-chromium-'));
  const words = ['--headless=new', '--no-sandbox', '--disable-dev-shm-usage', '--remote-debugging-pipe', `--user-data-dir=${profile}`, '--no-first-run', '--hide-scrollbars', ...SOFTWARE, ...more, 'about:blank'];
  const child = spawn(CHROMIUM, words, { stdio: ['ignore', 'ignore', process.env.EIGENCAST_CHROMIUM_LOG ? 'inherit' : 'ignore', 'pipe', 'pipe'] });
  const pipe = new Pipe(child.stdio[3], child.stdio[4]), tabs = new Map();
  pipe.onEvent = (event) => tabs.get(event.sessionId)?.take(event);
  return {
    async tab() {
      const { targetId } = await pipe.send('Target.createTarget', { url: 'about:blank' });
      const { sessionId } = await pipe.send('Target.attachToTarget', { targetId, flatten: true });
      const tab = new Tab(pipe, sessionId, targetId);
      tabs.set(sessionId, tab);
      for (const domain of ['Page', 'Runtime', 'Log']) await tab.send(`${domain}.enable`);
      return tab;
    },
    /** Until its own start takes no more of the processor, or ten seconds have passed. */
    async settled() {
      for (let before = NaN, looks = 0; looks < 40; ++looks) {
        const { processInfo } = await pipe.send('SystemInfo.getProcessInfo'), seconds = processInfo.reduce((sum, { cpuTime }) => sum + cpuTime, 0);
        if (seconds - before < 0.03) return;
        before = seconds;
        await new Promise((resolve) => setTimeout(resolve, 250));
      }
    },
    async stop() {
      const ended = new Promise((resolve) => child.on('exit', resolve)), timer = setTimeout(() => child.kill('SIGKILL'), 5000);
      pipe.send('Browser.close').catch(() => {});
      await ended;
      clearTimeout(timer);
      rmSync(profile, { recursive: true, force: true, maxRetries: 20, retryDelay: 100 });
    },
  };
}
