// SPDX-License-Identifier: MIT
//
// A screen of Xvfb, for browsers whose headless mode draws no WebGL.
import { spawn } from 'node:child_process';
import { existsSync } from 'node:fs';

const XVFB = '/usr/bin/Xvfb';
export const HAS_SCREEN = existsSync(XVFB);

/** What the first match of `pattern` in what a stream says captures. */
export function heard(stream, pattern, child, what) {
  return new Promise((resolve, reject) => {
    let text = '';
    stream.setEncoding('utf8').on('data', (more) => {
      text = (text + more).slice(-65536);
      const match = pattern.exec(text);
      if (match) resolve(match[1]);
    });
    child.on('exit', () => reject(new Error(`${what} ended: ${text}`)));
  });
}

/** Variables for what is to be seen there, which is drawn by the processor; stop(). */
export async function startScreen() {
  const screen = spawn(XVFB, ['-displayfd', '3', '-screen', '0', '1024x768x24', '-nolisten', 'tcp'], { stdio: ['ignore', 'ignore', 'ignore', 'pipe'] });
  const display = await heard(screen.stdio[3], /^(\d+)\n/, screen, 'Xvfb');
  return { environment: { ...process.env, DISPLAY: `:${display}`, LIBGL_ALWAYS_SOFTWARE: '1' }, stop: () => screen.kill() };
}

/** Until the expression is true in the tab. */
export async function until(tab, expression, limitMs = 60_000) {
  for (const end = Date.now() + limitMs; ; await new Promise((resolve) => setTimeout(resolve, 25))) {
    const value = await tab.evaluate(`(() => { try { return ${expression} } catch { return false } })()`).catch(() => false);
    if (value) return value;
    if (Date.now() > end) throw new Error(`${expression} did not come; console: ${tab.console.join(' | ')}; page: ${await tab.evaluate('document.body?.innerText')}`);
  }
}
