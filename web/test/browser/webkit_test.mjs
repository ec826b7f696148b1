// SPDX-License-Identifier: MIT
//
// The page in WebKitGTK, with a real broker and real senders (EIGENCAST_BIN).
import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { Programs } from '../system/programs.mjs';
import { CLAY, PRINT, button, hasState } from './looks.mjs';
import { startSite } from './site.mjs';
import { HAS_WEBKIT, startWebKit } from './webkit.mjs';

if (!HAS_WEBKIT) {
  console.log('no WebKitWebDriver, or no Xvfb: deploy/install-packages.sh full');
  process.exit(77);
}

const programs = new Programs(), LIMIT_MS = 150_000;
let broker, site, webkit;
before(async () => {
  broker = await programs.broker();
  programs.ring(broker, 'still');
  site = await startSite(broker.port);
  webkit = await startWebKit();
});
after(async () => {
  await webkit?.stop();
  await site?.stop();
  programs.stop();
});

test('TheListLeadsToAStreamThatTurnsByKeys', async () => {
  const { tab } = webkit;
  await tab.open(`${site.url}/`);
  await tab.until(`[...document.querySelectorAll('.streams dt')].some((name) => name.textContent === 'still') && ${CLAY} > 50`, LIMIT_MS);
  await tab.evaluate("void [...document.querySelectorAll('.streams a')].find((a) => a.textContent.includes('still')).click()");
  await tab.until(`location.pathname === '/still' && ${hasState('live')} && ${CLAY} > 100`, LIMIT_MS);
  await tab.evaluate(`void ${button('pause')}.click()`);
  await tab.until(`${button('pause')}.getAttribute('aria-pressed') === 'true'`, LIMIT_MS);
  const print = await tab.evaluate(PRINT);
  await tab.key('ArrowRight');
  await tab.until(`${PRINT} !== ${print}`, LIMIT_MS);
});

test('AStreamMovesFromItsBeginningUntilItsSenderHasGone', async () => {
  const { tab } = webkit;
  await tab.open(`${site.url}/lab/heart`);
  await tab.until(hasState('waiting'), LIMIT_MS);
  const sender = programs.sender(broker, 'lab/heart', 'heart', '--rank', '24');
  await tab.until(`${hasState('live')} && document.querySelector('.note').hidden && ${CLAY} > 100`, LIMIT_MS);
  const print = await tab.evaluate(PRINT);
  await tab.until(`${PRINT} !== ${print}`, LIMIT_MS);
  await sender.stop('SIGKILL');
  await tab.until("/the sender is gone, this is its last pose/.test(document.querySelector('.banner').textContent)", LIMIT_MS);
  assert.equal(await tab.evaluate("document.querySelector('h1').textContent"), 'lab/heart');
});
