// SPDX-License-Identifier: MIT
//
// Firefox by WebDriver BiDi, on a screen of Xvfb: headless, Debian's has no WebGL.
import { spawn } from 'node:child_process';
import { existsSync, mkdtempSync, rmSync, writeFileSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { ws } from '../unit/fake_broker.mjs';
import { HAS_SCREEN, heard, startScreen, until } from './screen.mjs';

export const FIREFOX = HAS_SCREEN ? [process.env.EIGENCAST_FIREFOX, '/usr/bin/firefox-esr', '/usr/bin/firefox'].find((path) => path && existsSync(path)) : undefined;
const PREFERENCES = {
  'webgl.force-enabled': true, 'browser.shell.checkDefaultBrowser': false, 'browser.startup.page': 0, 'datareporting.policy.dataSubmissionEnabled': false,
  'app.normandy.enabled': false, 'browser.safebrowsing.update.enabled': false, 'network.captive-portal-service.enabled': false, 'network.connectivity-service.enabled': false,
};

/** A tab, as that of chromium.mjs. */
class Tab {
  /** What the page wrote to its console, exceptions among it. */
  console = [];

  constructor(send, context) {
    this.send = send;
    this.context = context;
  }
  async open(url) {
    await this.send('browsingContext.navigate', { context: this.context, url, wait: 'none' });
  }
  /** Of an expression, awaited. */
  async evaluate(expression) {
    const { result, exceptionDetails } = await this.send('script.evaluate', {
      expression: `Promise.resolve(${expression}).then((value) => JSON.stringify(value) ?? null)`, target: { context: this.context }, awaitPromise: true, userActivation: true,
    });
    if (exceptionDetails) throw new Error(exceptionDetails.text);
    return result.type === 'string' ? JSON.parse(result.value) : undefined;
  }
  until(expression, limitMs) {
    return until(this, expression, limitMs);
  }
  /** Before the scripts of each page that is opened from now on. */
  async preload(source) {
    await this.send('script.addPreloadScript', { functionDeclaration: `() => { ${source}; }`, contexts: [this.context] });
  }
  async key(key) {
    const actions = ['keyDown', 'keyUp'].map((type) => ({ type, value: { ArrowRight: '\uE014' }[key] ?? key }));
    await this.send('input.performActions', { context: this.context, actions: [{ type: 'key', id: 'keys', actions }] });
  }
  async size(width, height) {
    await this.send('browsingContext.setViewport', { context: this.context, viewport: { width, height }, devicePixelRatio: 1 });
  }
  async close() {
    await this.send('browsingContext.close', { context: this.context });
  }
}

export async function startFirefox() {
  const profile = mkdtempSync(join(tmpdir(), 'eigencast-firefox-'));
  writeFileSync(join(profile, 'user.js'), Object.entries(PREFERENCES).map(([name, value]) => `user_pref("${name}", ${JSON.stringify(value)});\n`).join(''));
  const screen = await startScreen();
  const child = spawn(FIREFOX, ['--remote-debugging-port', '0', '--profile', profile, '--no-remote', 'about:blank'], {
    stdio: ['ignore', 'ignore', 'pipe'], env: { ...screen.environment, HOME: profile, MOZ_DISABLE_CONTENT_SANDBOX: '1' },
  });
  const url = await heard(child.stderr, /WebDriver BiDi listening on (ws:\S+)/, child, 'Firefox');
  const socket = new ws.WebSocket(`${url}/session`, { perMessageDeflate: false }), waiting = new Map(), tabs = new Map();
  await new Promise((resolve, reject) => socket.on('open', resolve).on('error', reject));
  let ids = 0;
  const send = (method, params = {}) => {
    const id = ++ids;
    socket.send(JSON.stringify({ id, method, params }));
    return new Promise((resolve, reject) => waiting.set(id, { resolve, reject, method }));
  };
  socket.on('message', (data) => {
    const { id, result, error, message, method, params } = JSON.parse(String(data));
    if (method === 'log.entryAdded') return void tabs.get(params.source.context)?.console.push(`${params.level}: ${params.text}`);
    const asked = waiting.get(id);
    if (!asked) return;
    waiting.delete(id);
    if (error) asked.reject(new Error(`${asked.method}: ${message}`));
    else asked.resolve(result);
  });
  await send('session.new', { capabilities: {} });
  await send('session.subscribe', { events: ['log.entryAdded'] });
  return {
    async tab() {
      const { context } = await send('browsingContext.create', { type: 'tab' });
      const tab = new Tab(send, context);
      tabs.set(context, tab);
      return tab;
    },
    async stop() {
      const ended = new Promise((resolve) => child.on('exit', resolve)), timer = setTimeout(() => child.kill('SIGKILL'), 10_000);
      send('browser.close').catch(() => {});
      await ended;
      clearTimeout(timer);
      socket.terminate();
      screen.stop();
      rmSync(profile, { recursive: true, force: true, maxRetries: 20, retryDelay: 100 });
    },
  };
}
