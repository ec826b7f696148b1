// SPDX-License-Identifier: MIT
//
// WebKitGTK by WebDriver, on a screen of Xvfb.
import { spawn } from 'node:child_process';
import { existsSync, mkdtempSync, readdirSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { freePort } from '../unit/fake_broker.mjs';
import { HAS_SCREEN, startScreen, until } from './screen.mjs';

const DRIVER = '/usr/bin/WebKitWebDriver', LIBRARIES = '/usr/lib';
/** Behind a folder of the machine's kind: /usr/lib/x86_64-linux-gnu/webkit2gtk-4.1/MiniBrowser. */
const browsers = () => readdirSync(LIBRARIES).filter((name) => name.includes('-linux-'))
  .flatMap((kind) => readdirSync(join(LIBRARIES, kind)).filter((name) => /^webkit(2)?gtk-/.test(name)).map((name) => join(LIBRARIES, kind, name, 'MiniBrowser')));
const BROWSER = HAS_SCREEN && existsSync(DRIVER) ? browsers().find(existsSync) : undefined;
export const HAS_WEBKIT = BROWSER !== undefined;

/** The one tab of a browser, as that of chromium.mjs; its console is not to be heard. */
class Tab {
  console = [];

  constructor(send) {
    this.send = send;
  }
  async open(url) {
    await this.send('url', { url });
  }
  /** Of an expression, awaited. */
  async evaluate(expression) {
    const script = `const done = arguments[0]; Promise.resolve().then(() => ${expression}).then((value) => done({ value: JSON.stringify(value) ?? null }), (error) => done({ error: String(error) }));`;
    const { value, error } = await this.send('execute/async', { script, args: [] });
    if (error) throw new Error(error);
    return value === null ? undefined : JSON.parse(value);
  }
  until(expression, limitMs) {
    return until(this, expression, limitMs);
  }
  async key(key) {
    const actions = ['keyDown', 'keyUp'].map((type) => ({ type, value: { ArrowRight: '\uE014' }[key] ?? key }));
    await this.send('actions', { actions: [{ type: 'key', id: 'keys', actions }] });
  }
}

export async function startWebKit() {
  const home = mkdtempSync(join(tmpdir(), 'eigencast-webkit-')), screen = await startScreen(), port = await freePort();
  const driver = spawn(DRIVER, [`--port=${port}`, '--host=127.0.0.1'], { stdio: 'ignore', env: { ...screen.environment, HOME: home, XDG_RUNTIME_DIR: home } });
  let isOver = false;
  const ended = new Promise((resolve) => driver.on('exit', () => resolve((isOver = true))));
  const ask = async (path, body, method = 'POST') => {
    const answer = await fetch(`http://127.0.0.1:${port}${path}`, { method, ...(body ? { body: JSON.stringify(body) } : {}) }), { value } = await answer.json();
    if (!answer.ok) throw new Error(`${path}: ${value.error}: ${value.message}`);
    return value;
  };
  const stop = async (session) => {
    if (session) await ask(session, undefined, 'DELETE').catch(() => {});
    driver.kill();
    await ended;
    screen.stop();
    rmSync(home, { recursive: true, force: true, maxRetries: 20, retryDelay: 100 });
  };
  try {
    for (const end = Date.now() + 60_000; !(await ask('/status', undefined, 'GET').catch(() => false)); await new Promise((resolve) => setTimeout(resolve, 50)))
      if (isOver || Date.now() > end) throw new Error('WebKitWebDriver does not start');
    const { sessionId } = await ask('/session', { capabilities: { alwaysMatch: { 'webkitgtk:browserOptions': { binary: BROWSER, args: ['--automation', '--geometry=480x400'] } } } }), session = `/session/${sessionId}`;
    await ask(`${session}/timeouts`, { script: 60_000, pageLoad: 150_000 });
    return { tab: new Tab((command, body) => ask(`${session}/${command}`, body)), stop: () => stop(session) };
  } catch (error) {
    await stop();
    throw error;
  }
}
