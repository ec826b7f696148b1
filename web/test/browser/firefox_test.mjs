// SPDX-License-Identifier: MIT
//
// The page in Firefox, with a real broker and real senders (EIGENCAST_BIN): what another engine might do otherwise.
import assert from 'node:assert/strict';
import { existsSync, readFileSync } from 'node:fs';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { BIN, Programs } from '../system/programs.mjs';
import { until } from '../unit/fake_broker.mjs';
import { CHROMIUM, startChromium } from './chromium.mjs';
import { FIREFOX, startFirefox } from './firefox.mjs';
import { CLAY, PRINT, button, hasState } from './looks.mjs';
import { startSite } from './site.mjs';

if (!FIREFOX) {
  console.log('no Firefox, or no Xvfb: deploy/install-packages.sh full');
  process.exit(77);
}

const programs = new Programs();
let broker, site, firefox;
before(async () => {
  broker = await programs.broker();
  programs.ring(broker, 'still');
  site = await startSite(broker.port);
  firefox = await startFirefox();
});
after(async () => {
  await firefox?.stop();
  await site?.stop();
  programs.stop();
});

/** A tab of its own; a page that says something on its console fails its test. */
async function onPage(path, use, { url = site.url } = {}) {
  const tab = await firefox.tab();
  try {
    await tab.size(480, 300);
    await tab.open(url + path);
    await use(tab);
    assert.deepEqual(tab.console, []);
  } finally {
    await tab.close();
  }
}

test('TheListLeadsToAStream', async () => {
  const late = '/v1/web/eigencast-levels.wasm';  // What is on its way when a page is left fails there, in Firefox.
  site.held.set(late, 0);
  await onPage('/', async (tab) => {
    await tab.until(`[...document.querySelectorAll('.streams dt')].some((name) => name.textContent === 'still') && ${CLAY} > 50`, 150_000);
    await until(() => site.held.get(late) > 0, late);
    site.held.delete(late);
    await tab.evaluate("[...document.querySelectorAll('.streams a')].find((a) => a.textContent.includes('still')).click()");
    await tab.until(`location.pathname === '/still' && ${hasState('live')} && ${CLAY} > 100`);
    await tab.evaluate(`${button('pause')}.click()`);
    await tab.until(`${button('pause')}.getAttribute('aria-pressed') === 'true'`);
    const print = await tab.evaluate(PRINT);
    await tab.key('ArrowRight');
    await tab.until(`${PRINT} !== ${print}`);
  });
});

test('BothBrowsersAndANativeViewerAreInOneRoom', { skip: CHROMIUM && existsSync(join(BIN, 'eigencast-client')) ? false : 'no Chromium, or no eigencast-client' }, async () => {
  const where = `http://127.0.0.1:${broker.port}`, path = (name) => `/still?room=still&name=${name}`, report = join(programs.folder, 'room.json');
  const names = (...all) => all.map((name) => `document.querySelector('.room')?.textContent.includes('${name}')`).join(' && ');
  const chromium = await startChromium(), leader = await chromium.tab();
  try {
    await leader.size(480, 300);
    await leader.open(where + path('Ada'));
    await leader.until(`${hasState('live')} && ${CLAY} > 100 && ${names('Ada (you)')}`, 150_000);
    await onPage(path('Bob'), async (tab) => {
      await tab.until(`${hasState('live')} && ${CLAY} > 100 && ${names('Ada', 'Bob (you)')}`, 150_000);
      const viewer = programs.start('eigencast-client', `${where}/still`, '--headless', '--size=64x48', '--duration=4', '--room=still', '--name=Cleo', `--json=${report}`);
      for (const one of [leader, tab]) await one.until(names('Ada', 'Bob', 'Cleo'));
      await leader.key('o');
      await tab.until(names('Ada (leads)'));
      const print = await tab.evaluate(PRINT);
      await leader.key('ArrowRight');
      await tab.until(`${PRINT} !== ${print}`);
      assert.equal(await viewer.ended, 0);
      assert.deepEqual(JSON.parse(readFileSync(report, 'utf8')).room.members.map(({ name }) => name).sort(), ['Ada', 'Bob', 'Cleo']);
    }, { url: where });
    assert.deepEqual(leader.console, []);
  } finally {
    await chromium.stop();
  }
});

test('ThePolicyOfABrokerAllowsAllOfItsPage', async () => {
  await onPage('/still', (tab) => tab.until(`${hasState('live')} && ${CLAY} > 100`, 150_000), { url: `http://127.0.0.1:${broker.port}` });
});

test('AStreamMovesFromItsBeginningUntilItsSenderHasGone', async () => {
  await onPage('/lab/heart', async (tab) => {
    await tab.until(hasState('waiting'));
    const sender = programs.sender(broker, 'lab/heart', 'heart', '--rank', '24');
    await tab.until(`${hasState('live')} && document.querySelector('.note').hidden && ${CLAY} > 100`, 150_000);
    const print = await tab.evaluate(PRINT);
    await tab.until(`${PRINT} !== ${print}`);
    await sender.stop('SIGKILL');
    await tab.until("/the sender is gone, this is its last pose/.test(document.querySelector('.banner').textContent)");
  });
});
