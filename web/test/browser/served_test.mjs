// SPDX-License-Identifier: MIT
//
// The page as the broker serves it, in Chromium, with real senders (EIGENCAST_BIN).
import assert from 'node:assert/strict';
import { spawn } from 'node:child_process';
import { readFileSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { BIN, Programs } from '../system/programs.mjs';
import { until } from '../unit/fake_broker.mjs';
import { CHROMIUM, startChromium } from './chromium.mjs';
import { CLAY, hasState } from './looks.mjs';
import { startSite } from './site.mjs';

if (!CHROMIUM) {
  console.log('no Chromium: deploy/install-packages.sh full');
  process.exit(77);
}

const PICTURES = process.env.EIGENCAST_PICTURES;
const programs = new Programs();
let broker, chromium;
before(async () => {
  broker = await programs.broker();
  programs.ring(broker, 'lab/still');
  chromium = await startChromium();
});
after(async () => {
  await chromium?.stop();
  programs.stop();
});

/** A tab of its own; a page that says something on its console fails its test. */
async function onPage(url, use) {
  const tab = await chromium.tab();
  try {
    await tab.size(480, 300);
    await tab.open(url);
    await use(tab);
    if (PICTURES) writeFileSync(join(PICTURES, `served-${new URL(url).port}.png`), await tab.screenshot());
    assert.deepEqual(tab.console, []);
  } finally {
    await tab.close();
  }
}
const isLive = `${hasState('live')} && ${CLAY} > 100`;

test('AStreamsUrlShowsIt', async () => {
  await onPage(`http://127.0.0.1:${broker.port}/lab/still`, async (tab) => {
    await tab.until(isLive, 150_000);
    const asked = await tab.evaluate("performance.getEntriesByType('resource').map(({ name }) => new URL(name).pathname)");
    assert.ok(asked.some((path) => /^\/v1\/web\/[0-9a-f]{16}\/page\.js$/.test(path)), String(asked));
  });
});

test('APathOfAProxyTakesNoSetting', async () => {
  const proxy = await startSite(broker.port, { prefix: '/tools/eigencast', isProxy: true });
  try {
    await onPage(`${proxy.url}/`, async (tab) => {
      await tab.until("[...document.querySelectorAll('.streams a')].some((a) => a.textContent.includes('lab/still'))");
      await tab.evaluate("[...document.querySelectorAll('.streams a')].find((a) => a.textContent.includes('lab/still')).click()");
      await tab.until(`location.pathname === '/tools/eigencast/lab/still' && ${isLive}`, 150_000);
    });
  } finally {
    await proxy.stop();
  }
});

test('PagesAndNativeViewersMeetInARoom', async () => {
  const url = (name) => `http://127.0.0.1:${broker.port}/lab/still?room=lab/still&name=${name}`, report = join(programs.folder, 'room.json');
  const names = (...all) => all.map((name) => `document.querySelector('.room').textContent.includes('${name}')`).join(' && ');
  await onPage(url('Ada'), async (ada) => {
    await ada.until(`${isLive} && ${names('Ada (you)')}`, 150_000);
    await onPage(url('Bob'), async (bob) => {
      await bob.until(`${isLive} && ${names('Ada', 'Bob (you)')}`, 150_000);
      await ada.until(names('Bob'));
      // Bob follows Ada, who leads.
      await ada.key('o');
      await bob.until(names('Ada (leads)'));
      await ada.mouse('mousePressed', 240, 150, { button: 'left', buttons: 1, clickCount: 1 });
      await ada.mouse('mouseMoved', 300, 170, { button: 'left', buttons: 1 });
      await ada.mouse('mouseReleased', 300, 170, { button: 'left', clickCount: 1 });
      // The ring covers the lower middle of the picture.
      for (let y = 120; y < 260 && !(await bob.evaluate("document.querySelector('.mark.pointer') !== null")); y += 20) {
        await ada.mouse('mouseMoved', 240, y);
        await new Promise((resolve) => setTimeout(resolve, 400));
      }
      await bob.until("document.querySelector('.mark.pointer span')?.textContent === 'Ada' && !document.querySelector('.mark.pointer').hidden");
      await ada.evaluate("document.querySelector('.room input').value = 'look here'");
      await ada.key('t');
      await bob.until("[...document.querySelectorAll('.mark:not(.pointer) span')].some((span) => span.textContent === 'look here')");
      const at = (tab) => tab.evaluate("document.querySelector('.mark:not(.pointer)').style.transform");
      const px = async (tab) => ((await at(tab)).match(/-?[\d.]+(?=px)/g) ?? []).map(Number);
      const [u, v] = await until(async () => (await px(bob)).length === 2 && px(bob), "the pin in Bob's picture");
      await ada.send('Page.bringToFront');  // Browsers draw tabs that are to be seen only.
      let last = [];
      await until(async () => Math.hypot((last = await px(ada))[0] - u, last[1] - v) < 5, 'the pin at the same place of both pictures', 20_000).catch((error) => assert.fail(`${error.message}: ${last} and ${u},${v}`));
      // A native viewer at a tenth of the vertices sees both, and the pin.
      const viewer = programs.start('eigencast-client', `http://127.0.0.1:${broker.port}/lab/still`, '--headless', '--duration', '6', '--lod', '0.1', '--room', 'lab/still', '--name', 'Cleo', '--json', report);
      await ada.until(names('Cleo'));
      assert.equal(await viewer.ended, 0);
      const seen = JSON.parse(readFileSync(report, 'utf8')).room;
      assert.deepEqual(seen.members.map(({ name }) => name).sort(), ['Ada', 'Bob', 'Cleo']);
      assert.deepEqual(seen.marks.filter(({ pin }) => pin).map(({ text }) => text), ['look here']);
      await ada.until(`!(${names('Cleo')})`);
    });
    await ada.until(`!(${names('Bob')})`);
  });
});

test('PagesElsewhereShowStreamsWhereTheyMay', async () => {
  const pages = {}, site = await startSite(1, { pages, hasPolicy: false });
  const open = await programs.broker(0, `--access-origins=${site.url}`);
  const sender = programs.ring(open, 'lab/still');
  const base = `http://127.0.0.1:${open.port}`;
  const icon = '<!doctype html><html lang="en"><title>elsewhere</title><link rel="icon" href="data:,">';
  pages['/element'] = `${icon}<script type="module" src="${base}/v1/web/element.js"></script><eigencast-view src="${base}/lab/still" style="height: 250px"></eigencast-view>`;
  pages['/frame'] = `${icon}<iframe src="${base}/lab/still?embed=1"></iframe>`;
  pages['/refused'] = `${icon}<iframe src="http://127.0.0.1:${broker.port}/lab/still?embed=1"></iframe>`;
  try {
    await onPage(`${site.url}/element`, (tab) => tab.until(`${CLAY} > 100`, 150_000));
    await onPage(`${site.url}/frame`, (tab) => tab.until("document.querySelector('iframe').contentDocument === null && performance.getEntriesByType('resource').length > 0"));
    const tab = await chromium.tab();
    await tab.open(`${site.url}/refused`);
    await until(() => tab.console.some((line) => /frame-ancestors/.test(line)), 'the refusal');
    await tab.close();
  } finally {
    sender.kill('SIGKILL');
    await open.stop();
    await site.stop();
  }
});

test('ASharedLinkShowsStreamsToOthers', async () => {
  const folder = join(programs.folder, 'shared');
  const words = ['--share', '--listen=0.0.0.0:0', '--admin-listen=127.0.0.1:0', `--port-file=${folder}.port`, `--data-dir=${folder}`, '--log-level=error'];
  const sharing = spawn(join(BIN, 'eigencast-broker'), words, { stdio: ['ignore', 'pipe', 'inherit'] });
  let said = '';
  sharing.stdout.setEncoding('utf8').on('data', (text) => (said += text));
  const ended = new Promise((resolve) => sharing.on('exit', resolve));
  try {
    const link = new URL(await until(() => /^http.*access_token=.*$/m.exec(said)?.[0], 'the link'));
    const sender = programs.ring({ port: link.port }, 'lab/still');
    await onPage(link.href, async (tab) => {
      await tab.until("[...document.querySelectorAll('.streams a')].some((a) => a.textContent.includes('lab/still'))");
      assert.ok(!(await tab.evaluate('location.href')).includes('access_token'), 'the address bar holds no token');
      await tab.evaluate("[...document.querySelectorAll('.streams a')].find((a) => a.textContent.includes('lab/still')).click()");
      await tab.until(isLive, 150_000);
      assert.equal(await tab.evaluate('isSecureContext'), link.hostname === '127.0.0.1');
    });
    sender.kill('SIGKILL');
  } finally {
    sharing.kill('SIGTERM');
    await ended;
  }
});
