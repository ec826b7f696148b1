// SPDX-License-Identifier: MIT
//
// Recordings in Chromium and Firefox, of a real broker and a real sender (EIGENCAST_BIN): in one file, and by Range.
import assert from 'node:assert/strict';
import { createReadStream, readFileSync, readdirSync, writeFileSync } from 'node:fs';
import { createServer } from 'node:http';
import { spawnSync } from 'node:child_process';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { pathToFileURL } from 'node:url';
import { BIN, Programs } from '../system/programs.mjs';
import { until } from '../unit/fake_broker.mjs';
import { CHROMIUM, startChromium } from './chromium.mjs';
import { FIREFOX, startFirefox } from './firefox.mjs';
import { CLAY, PRINT } from './looks.mjs';
import { startSite } from './site.mjs';

if (!CHROMIUM) {
  console.log('no Chromium: deploy/install-packages.sh full');
  process.exit(77);
}

const PICTURES = process.env.EIGENCAST_PICTURES;
const programs = new Programs(), page = join(programs.folder, 'show.html');
let recording, chromium;
before(async () => {
  const broker = await programs.broker(0, '--recording-streams=**', '--recording-include-asset=true');
  // Played twice: keys are predicted from what is remembered.
  const sender = programs.sender(broker, 'lab/heart', 'heart', '--rank', '24', '--memory', 'on', '--frames', '240');
  assert.equal(await sender.ended, 0);
  await broker.stop();
  const folder = readdirSync(programs.folder).filter((name) => /^data/.test(name))[0];
  recording = join(programs.folder, folder, 'recordings', readdirSync(join(programs.folder, folder, 'recordings'))[0]);
  const { status, stderr } = spawnSync(join(BIN, 'eigencast-sender'), ['export', recording, '--to', page, '--no-progress'], { encoding: 'utf8' });
  assert.equal(status, 0, stderr);
  chromium = await startChromium();
});
after(async () => {
  await chromium?.stop();
  programs.stop();
});

/** Plays, halts, is sought, and says nothing on its console. */
async function check(browser, url, name) {
  const tab = await browser.tab(), position = "Number(document.querySelector('.timeline input').value)";
  try {
    await tab.size(640, 400);
    await tab.open(url);
    await tab.until(`${CLAY} > 100 && ${position} > 0.3`, 150_000);
    assert.equal(await tab.evaluate("document.querySelector('h1').textContent"), 'lab/heart');
    await tab.evaluate("document.querySelector('.timeline button').click()");
    await tab.until("document.querySelector('.timeline button').getAttribute('aria-label') === 'Play'");
    const seek = (seconds) => tab.evaluate(`(() => { const bar = document.querySelector('.timeline input'); bar.value = ${seconds}; bar.dispatchEvent(new Event('input')); })()`);
    const paused = await tab.evaluate(PRINT), elsewhere = (await tab.evaluate(position)) > 3 ? 1 : 5.5;
    await seek(elsewhere);
    await tab.until(`${position} === ${elsewhere}`);
    await tab.until(`${PRINT} !== ${paused}`);
    const one = await tab.evaluate(PRINT);
    await seek(4.2);
    await tab.until(`${PRINT} !== ${one}`);
    // Of poses that lie anywhere; the bar shows hundredths of seconds.
    const stepped = async (key, isThere) => {
      await tab.key(key);
      return tab.evaluate(`${position} ${isThere}`);
    };
    await until(() => stepped('.', '> 4.25'), 'a pose later');
    await until(() => stepped(',', '< 4.25'), 'a pose earlier');
    if (PICTURES && tab.screenshot) writeFileSync(join(PICTURES, `recording-${name}.png`), await tab.screenshot());
    assert.deepEqual(tab.console, []);
  } finally {
    await tab.close();
  }
}

test('APageInOneFilePlaysFromTheDisk', async () => {
  const html = readFileSync(page, 'utf8');
  assert.ok(!/(src|href)="(?!data:)/.test(html.replace(/<script type="module">[^]*?<\/script>/, '')), 'it loads nothing');
  await check(chromium, pathToFileURL(page).href, 'file');
});

test('APageInOneFilePlaysInFirefox', { skip: FIREFOX ? false : 'no Firefox, or no Xvfb: deploy/install-packages.sh full' }, async () => {
  const firefox = await startFirefox();
  try {
    await check(firefox, pathToFileURL(page).href, 'firefox');
  } finally {
    await firefox.stop();
  }
});

/** Serves the recording by Range, and the page; headers: of parts of the recording. `use(url, ranges)` */
async function withPlainServer(headers, use) {
  const size = readFileSync(recording).length, ranges = [];
  const server = createServer((request, response) => {
    const [, from = 0, to = size] = /^bytes=(\d+)-(\d+)$/.exec(request.headers.range ?? '') ?? [];
    if (!/^[^?]*\.ecrec$/.test(request.url)) return createReadStream(page).pipe(response.writeHead(200, { 'content-type': 'text/html' }));
    const end = Math.min(Number(to), size - 1), range = request.headers.range ? { 'content-range': `bytes ${from}-${end}/${size}` } : {};
    ranges.push(end);
    createReadStream(recording, { start: Number(from), end }).pipe(response.writeHead(request.headers.range ? 206 : 200, { ...range, ...headers }));
  });
  await new Promise((resolve) => server.listen(0, '127.0.0.1', resolve));
  try {
    await use(`http://127.0.0.1:${server.address().port}`, ranges);
  } finally {
    server.close();
    server.closeAllConnections();
  }
}

test('APlainServersRecordingPlaysByRange', () => withPlainServer({}, async (url, ranges) => {
  // The page has one inside, too.
  await check(chromium, `${url}/show.html?file=heart.ecrec`, 'range');
  assert.ok(ranges.length > 0);
}));

// Other origins' servers say of how much a part is where they say so.
for (const [name, more] of [['ByRange', { 'access-control-expose-headers': 'content-range' }], ['AsAWhole', {}]]) {
  test(`AnElementPlaysARecording${name}`, () => withPlainServer({ 'access-control-allow-origin': '*', ...more }, async (url, ranges) => {
    const html = `<!doctype html><html lang="en"><title>anybody's</title><script type="module" src="/v1/web/element.js"></script><body><eigencast-view src="${url}/heart.ecrec" style="width: 320px"></eigencast-view></body></html>`;
    const site = await startSite(1, { pages: { '/': html }, hasPolicy: false }), tab = await chromium.tab(), element = "document.querySelector('eigencast-view')";
    try {
      await tab.size(640, 400);
      await tab.open(`${site.url}/`);
      await tab.until(`${CLAY} > 100 && ${element}.currentTime > 0.3`, 150_000);
      assert.equal(ranges.length === 2 && ranges[1] === readFileSync(recording).length - 1, name === 'AsAWhole');
      await tab.evaluate(`${element}.pause()`);
      const seek = async (seconds) => {
        const before = await tab.evaluate(PRINT);
        await tab.evaluate(`void (${element}.currentTime = ${seconds})`);
        await tab.until(`${PRINT} !== ${before}`);
        assert.equal(await tab.evaluate(`${element}.currentTime`), seconds);
      };
      await seek(6.5);
      assert.ok(await tab.evaluate(`${element}.paused && ${element}.duration > 7.5 && ${element}.duration < 9`));
      await seek(1.25);
      await tab.evaluate(`${element}.playbackRate = 4, ${element}.play()`);
      await tab.until(`${element}.currentTime > 2`);
      if (PICTURES) writeFileSync(join(PICTURES, `recording-element-${name}.png`), await tab.screenshot());
      assert.deepEqual(tab.console, []);
    } finally {
      await tab.close();
      await site.stop();
    }
  }));
}

test('ABrokersPageLeadsThere', async () => {
  const broker = await programs.broker(), tab = await chromium.tab();
  try {
    await tab.open(`http://127.0.0.1:${broker.port}/?file=gone.ecrec`);
    assert.match(await tab.until("/cannot be shown.*/.exec(document.body.innerText)?.[0]"), /gone\.ecrec/);
    assert.match(await tab.evaluate('location.href'), /\/show\.html\?file=gone\.ecrec$/);
  } finally {
    await tab.close();
    await broker.stop();
  }
});
