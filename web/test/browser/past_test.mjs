// SPDX-License-Identifier: MIT
//
// What a broker keeps of a stream, in Chromium: a real broker and real senders (EIGENCAST_BIN).
import assert from 'node:assert/strict';
import { existsSync, readFileSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { BIN, Programs } from '../system/programs.mjs';
import { CHROMIUM, startChromium } from './chromium.mjs';
import { CANVAS, CLAY, hasState } from './looks.mjs';
import { makePng, readPng } from './pictures.mjs';

if (!CHROMIUM) {
  console.log('no Chromium: deploy/install-packages.sh full');
  process.exit(77);
}

const PICTURES = process.env.EIGENCAST_PICTURES, LIMIT_MS = 150_000;
const programs = new Programs();
let chromium;
before(async () => (chromium = await startChromium()));
after(async () => {
  await chromium?.stop();
  programs.stop();
});

const ring = (stretch) => {
  const pose = [];
  for (let i = 0; i < 48; ++i) {
    for (let k = 0; k < 20; ++k) {
      const u = (2 * Math.PI * i) / 48, v = (2 * Math.PI * k) / 20, out = 1 + (0.35 + 0.08 * Math.sin(3 * u)) * Math.cos(v);
      pose.push(stretch * out * Math.cos(u), (0.35 + 0.08 * Math.sin(3 * u)) * Math.sin(v), out * Math.sin(u));
    }
  }
  return Buffer.from(Float32Array.from(pose).buffer);
};
const SAYS = "(document.querySelector('.state.behind')?.textContent ?? '')", BAR = "document.querySelector('.timeline input')";
const isLive = `${hasState('live')} && ${CLAY} > 100`;
/** The part of the picture that the surface covers, whatever its resolution. */
const AREA = `(${CLAY} / (document.querySelector('canvas').width * document.querySelector('canvas').height))`;
const isNear = (area) => `Math.abs(${AREA} - ${area}) < ${0.03 * area}`;
/** To a moment by the clock of this machine, the broker's: milliseconds. */
const seek = (tab, atMs) => tab.evaluate(`(() => { const bar = ${BAR}; bar.value = Number(bar.max) - (Date.now() - ${atMs}) / 1000; bar.dispatchEvent(new Event('input')); })()`);
const wait = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

async function onPage(url, use) {
  const tab = await chromium.tab();
  try {
    await tab.size(640, 400);
    await tab.open(url);
    await use(tab);
    assert.deepEqual(tab.console, []);
  } finally {
    await tab.close();
  }
}
/** Once it stays the same. */
async function settledArea(tab) {
  for (let last = 0, times = 0; ; await wait(300)) {
    const now = await tab.evaluate(AREA);
    times = Math.abs(now - last) < 0.01 * now ? times + 1 : 0;
    last = now;
    if (times === 5) return now;
  }
}

test('ASeekShowsThePictureOfThatTime', async () => {
  const broker = await programs.broker(0, '--history-streams=**'), sender = programs.ring(broker, 'lab/ring', undefined, false);
  const url = `http://127.0.0.1:${broker.port}/lab/ring`;
  let pose = ring(1);
  const feeding = setInterval(() => sender.stdin.write(pose), 100);
  feeding.unref();
  await onPage(url, async (tab) => {
    await tab.until(`${isLive} && ${BAR} !== null`, LIMIT_MS);
    const first = await settledArea(tab);
    await wait(2000);
    const changedMs = Date.now();
    pose = ring(1.6);
    await tab.until(`${AREA} > ${1.1 * first}`, LIMIT_MS);
    const second = await settledArea(tab);
    await tab.evaluate("document.querySelector('.timeline button').click()");  // It halts, so that the past stands still.
    await tab.until("document.querySelector('.timeline button').getAttribute('aria-label') === 'Play'");
    await seek(tab, changedMs - 1000);
    await tab.until(isNear(first), LIMIT_MS);
    assert.match(await tab.evaluate(SAYS), /^[\d:.]+( s)? behind live$/);
    if (PICTURES) writeFileSync(join(PICTURES, 'past.png'), await tab.screenshot());
    await onPage(url, (other) => other.until(`${isLive} && ${isNear(second)}`, LIMIT_MS));
    assert.ok(await tab.evaluate(isNear(first)), 'nobody else is live for it');
    await tab.key('End');
    await tab.until(`${isNear(second)} && ${SAYS} === ''`, LIMIT_MS);
  });
  clearInterval(feeding);
  await broker.stop();
});

test('PosesAreSteppedAndPlayedByKeys', async () => {
  const broker = await programs.broker(0, '--history-streams=**');
  programs.sender(broker, 'lab/heart', 'heart', '--rank', '24');
  await onPage(`http://127.0.0.1:${broker.port}/lab/heart`, async (tab) => {
    await tab.until(`${isLive} && Number(${BAR}?.max) > 5`, LIMIT_MS);
    const position = `Number(${BAR}.value)`;
    /** The moment that is shown after a key. */
    const stepped = async (key) => {
      await tab.key(key);
      return tab.until(`document.querySelector('.timeline').getAttribute('aria-busy') === 'false' && ${SAYS} !== '' && Date.parse(document.querySelector('.state.behind').title)`, LIMIT_MS);
    };
    const [one, two, three] = [await stepped(','), await stepped(','), await stepped('.')];
    assert.ok(two < one, `${two} is before ${one}`);
    assert.equal(three, one);
    await seek(tab, Date.now() - 4000);
    await tab.until(`${BAR}.max - ${position} >= 4`, LIMIT_MS);
    await tab.key(' ');
    const at = await tab.evaluate(position);
    await tab.until(`${position} > ${at} + 1`, LIMIT_MS);
    assert.notEqual(await tab.evaluate(SAYS), '');
    await tab.key(']');
    await tab.until(`${SAYS} === ''`, LIMIT_MS);  // Twice as fast it is live soon.
    await tab.until(isLive, LIMIT_MS);
  });
  await broker.stop();
});

test('WhoFollowsGoesWhereTheLeaderIs', async () => {
  const broker = await programs.broker(0, '--history-streams=**');
  programs.sender(broker, 'lab/heart', 'heart', '--rank', '24');
  const url = (name) => `http://127.0.0.1:${broker.port}/lab/heart?room=lab/heart&name=${name}`, here = (name) => `document.querySelector('.room')?.textContent.includes('${name}')`;
  await onPage(url('Ada'), async (ada) => {
    await ada.until(`${isLive} && Number(${BAR}?.max) > 4 && ${here('Ada')}`, LIMIT_MS);
    await onPage(url('Bob'), async (bob) => {
      await bob.until(`${isLive} && ${BAR} !== null && ${here('Ada')}`, LIMIT_MS);
      await ada.key('o');
      await bob.until(here('Ada (leads)'), LIMIT_MS);
      await ada.evaluate("document.querySelector('.timeline button').click()");
      await seek(ada, Date.now() - 3000);
      await bob.until(`${SAYS} !== '' && document.querySelector('.timeline button').getAttribute('aria-label') === 'Play'`, LIMIT_MS);
      await ada.key('End');
      await bob.until(`${SAYS} === ''`, LIMIT_MS);
    });
  });
  await broker.stop();
});

/** By who is headless: the coefficients that it showed last, and its number of pictures. */
const lastShown = (file) => {
  const lines = existsSync(file) ? readFileSync(file, 'utf8').split('\n').slice(0, -1) : [];
  return { pictures: lines.length, pose: lines.length > 0 ? String(JSON.parse(lines.at(-1)).coefficients) : '' };
};
/** Which pixels are of the surface. */
const maskOf = ({ rgb, width, height }) => Uint8Array.from({ length: width * height }, (_, i) => Number(rgb[3 * i] > rgb[3 * i + 2] + 60));
/** Of two masks, what both have over what either has. */
function overlap(a, b) {
  let both = 0, either = 0;
  a.forEach((value, i) => ((both += value & b[i]), (either += value | b[i])));
  return both / either;
}

test('TwoPagesAndTwoNativeViewersAreAtOneMomentOfThePast', { skip: existsSync(join(BIN, 'eigencast-client')) ? false : 'no eigencast-client' }, async () => {
  const broker = await programs.broker(0, '--history-streams=**'), where = `http://127.0.0.1:${broker.port}/lab/heart`;
  programs.sender(broker, 'lab/heart', 'heart', '--rank', '24');
  const url = (name) => `${where}?room=lab/heart&name=${name}`, here = (name) => `document.querySelector('.room')?.textContent.includes('${name}')`;
  const natives = [];
  const native = (name) => {
    const [shown, report, picture] = ['shown', 'report', 'png'].map((kind) => join(programs.folder, `${name}.${kind}`));
    const client = programs.start('eigencast-client', where, '--headless', '--size=640x400', '--rate=raw', '--colour=clay', '--room=lab/heart', `--name=${name}`,
      `--record-shown=${shown}`, `--json=${report}`, `--screenshot=${picture}`, '--wait=150');
    natives.push({ client, shown, report, picture });
  };
  await onPage(url('Ada'), async (ada) => {
    await ada.until(`${isLive} && Number(${BAR}?.max) > 6 && ${here('Ada')}`, LIMIT_MS);
    native('Cleo');
    await ada.until(here('Cleo'), LIMIT_MS);
    await ada.key('o');
    await ada.mouse('mousePressed', 200, 150, { button: 'left', buttons: 1, clickCount: 1 });
    await ada.mouse('mouseMoved', 260, 170, { button: 'left', buttons: 1 });
    await ada.mouse('mouseReleased', 260, 170, { button: 'left', clickCount: 1 });
    await ada.evaluate("document.querySelector('.timeline button').click()");
    await seek(ada, Date.now() - 4000);
    await ada.until(`${SAYS} !== ''`, LIMIT_MS);
    native('Dan');  // He and Bob come while all stand still.
    await onPage(url('Bob'), async (bob) => {
      await bob.until(`${SAYS} !== '' && document.querySelector('.timeline button').getAttribute('aria-label') === 'Play'`, LIMIT_MS);
      await ada.until(here('Dan'), LIMIT_MS);
      const TIME = "Date.parse(document.querySelector('.state.behind').title)", SETTLED = "document.querySelector('.timeline').getAttribute('aria-busy') === 'false'";
      await Promise.all([ada, bob].map((tab) => tab.until(SETTLED, LIMIT_MS)));
      const atMs = await ada.evaluate(TIME);
      await bob.until(`${TIME} === ${atMs}`, LIMIT_MS);
      const end = Date.now() + LIMIT_MS;
      let last;
      do {
        await wait(700);
        last = natives.map(({ shown }) => lastShown(shown));
        assert.ok(Date.now() < end, `the native viewers show ${JSON.stringify(last.map(({ pose }) => pose.slice(0, 80)))}`);
      } while (last.some(({ pose }) => pose === '' || pose !== last[0].pose) || natives.some(({ shown }, i) => lastShown(shown).pictures !== last[i].pictures));
      const pages = [];
      for (const tab of [ada, bob]) {
        await tab.send('Page.bringToFront');  // Those behind are not drawn.
        await settledArea(tab);
        pages.push(readPng(Buffer.from((await tab.evaluate(CANVAS)).split(',')[1], 'base64')));
      }
      for (const { client } of natives) await client.stop();
      for (const { report } of natives) {
        const { at_us } = JSON.parse(readFileSync(report, 'utf8')).shown;
        assert.ok(Math.abs(at_us / 1000 - atMs) < 1.5, `${at_us} us, not ${atMs} ms`);
      }
      const pictures = [...pages, ...natives.map(({ picture }) => readPng(readFileSync(picture)))], masks = pictures.map(maskOf);
      if (PICTURES) {
        pages.forEach((page, i) => writeFileSync(join(PICTURES, `together_page${i}.png`), makePng(page.width, page.height, (x, y) => [...page.rgb.subarray(3 * (y * page.width + x), 3 * (y * page.width + x) + 3)])));
        natives.forEach(({ picture }, i) => writeFileSync(join(PICTURES, `together_native${i}.png`), readFileSync(picture)));
        const tones = [0, 1, 2, 3].map((i) => (x, y) => masks[i][y * 640 + x]);
        writeFileSync(join(PICTURES, 'together.png'), makePng(640, 400, (x, y) => { const sum = tones.reduce((all, tone) => all + tone(x, y), 0); return sum === 0 ? [255, 255, 255] : sum === 4 ? [90, 140, 90] : [255, 0, 0]; }));
      }
      const overlaps = masks.slice(1).map((mask) => overlap(masks[0], mask));
      console.log(`overlaps with Ada's: ${overlaps.map((one) => one.toFixed(4)).join(', ')}`);
      assert.ok(Math.min(...overlaps) > 0.97, String(overlaps));
    });
  });
  await broker.stop();
});

test('WhoMayNotSeesNoTimelineAndWhy', async () => {
  const broker = await programs.broker(0, '--history-streams=**', '--access-anonymous-rewind=nothing');
  programs.ring(broker, 'lab/ring');
  await onPage(`http://127.0.0.1:${broker.port}/lab/ring`, async (tab) => {
    await tab.until(isLive, LIMIT_MS);
    const end = Date.now() + LIMIT_MS;
    do {
      await tab.key(',');
      await wait(300);
    } while (!(await tab.evaluate("document.querySelector('.banner').textContent.includes('(refused)')")) && Date.now() < end);
    assert.ok(Date.now() < end, 'it does not say why');
    assert.equal(await tab.evaluate("document.querySelector('.timeline')"), null);
  });
  await broker.stop();
});
