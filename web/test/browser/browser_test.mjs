// SPDX-License-Identifier: MIT
//
// The page in Chromium, with a real broker and real senders (EIGENCAST_BIN).
import assert from 'node:assert/strict';
import { spawn, spawnSync } from 'node:child_process';
import { existsSync, readFileSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { fileURLToPath } from 'node:url';
import { BIN, Programs } from '../system/programs.mjs';
import { until } from '../unit/fake_broker.mjs';
import { ROOT } from '../unit/support.mjs';
import { CHROMIUM, startChromium } from './chromium.mjs';
import { CLAY, PRINT, button, hasState } from './looks.mjs';
import { makePng, readPng, similarity } from './pictures.mjs';
import { startSite } from './site.mjs';
import { COUNTS, publishWall } from './wall.mjs';

if (!CHROMIUM) {
  console.log('no Chromium: deploy/install-packages.sh full');
  process.exit(77);
}

const WIDTH = 480, HEIGHT = 300;
/** A folder for the pictures that are compared, to be looked at. */
const PICTURES = process.env.EIGENCAST_PICTURES;
const programs = new Programs();
const picturePage = {
  '/picture': '<!doctype html><html lang="en"><title>picture</title><link rel="stylesheet" href="/picture.css"><script type="module" src="/picture.js"></script><body></body></html>',
  '/picture.css': `body { margin: 0; } .picture { display: block; width: ${WIDTH}px; height: ${HEIGHT}px; }`,
  '/picture.js': readFileSync(fileURLToPath(new URL('picture_page.mjs', import.meta.url)), 'utf8'),
};
let broker, site, chromium;
before(async () => {
  broker = await programs.broker();
  programs.ring(broker, 'still');
  site = await startSite(broker.port, { pages: picturePage });
  chromium = await startChromium();
});
after(async () => {
  await chromium?.stop();
  await site?.stop();
  programs.stop();
});

/** A tab of its own; a page that says something on its console fails its test. */
async function onPage(url, use, { size = [WIDTH, HEIGHT] } = {}) {
  const tab = await chromium.tab();
  try {
    await tab.size(...size);
    await tab.open(url);
    await use(tab);
    assert.deepEqual(tab.console, []);
  } finally {
    await tab.close();
  }
}
test('AStreamIsShownFromBeforeItBeginsUntilItsSenderHasGone', async () => {
  await onPage(`${site.url}/lab/heart`, async (tab) => {
    await tab.until(hasState('waiting'));
    assert.match(await tab.until("document.querySelector('.note').innerText"), /Waiting for a sender.*eigencast-sender play heart --to ws:\/\/[^ ]*\/lab\/heart/s);
    assert.match(await tab.evaluate("document.querySelector('canvas').getAttribute('aria-label')"), /lab\/heart.*waiting for a sender/);
    const { nodes } = await tab.send('Accessibility.getFullAXTree', {});
    const nameless = nodes.filter(({ ignored, role, name }) => !ignored && /^(button|link|image|textbox|toolbar)$/.test(role?.value) && !name?.value);
    assert.deepEqual(nameless, [], 'what a screen reader meets has a name');
    const sender = programs.sender(broker, 'lab/heart', 'heart', '--rank', '24');
    await tab.until(`${hasState('live')} && document.querySelector('.note').hidden && ${CLAY} > 100`, 150_000);
    await sender.stop('SIGKILL');
    await tab.until("/no data for .* the sender is gone, this is its last pose/.test(document.querySelector('.banner').textContent)");
    await tab.until(`${CLAY} === 0`);  // Grey.
    programs.sender(broker, 'lab/heart', 'heart', '--rank', '24');
    await tab.until(`${hasState('live')} && document.querySelector('.banner').hidden && ${CLAY} > 100`);
  });
});

test('WhatHoldsTheRateComesBehindTheFirstPictureOfASurface', async () => {
  const tab = await chromium.tab(), levels = "performance.getEntriesByType('resource').find(({ name }) => name.endsWith('eigencast-levels.wasm'))?.startTime";
  await tab.preload(`(() => {
    const context = WebGL2RenderingContext.prototype, drawElements = context.drawElements;
    context.drawElements = function (mode, count, ...more) {
      if (count > 3) window.firstMs ??= performance.now();
      return drawElements.call(this, mode, count, ...more);
    };
  })()`);
  await tab.open(`${site.url}/still`);
  const startMs = await tab.until(levels, 150_000), firstMs = await tab.evaluate('window.firstMs ?? Infinity');
  assert.ok(startMs >= firstMs, `${startMs} after ${firstMs}`);
  await tab.close();
});

test('TwoStreamsOfOneSurfaceAreCompared', async () => {
  const senders = [['compare/a'], ['compare/b', '--speed', '0.5']].map(([name, ...more]) => programs.sender(broker, name, 'heart', '--rank', '24', ...more));
  await onPage(`${site.url}/compare/a?rate=raw&compare=compare/b`, async (tab) => {
    const said = await tab.until("/rms ([0-9.]+) %, largest ([0-9.]+) %/.exec(document.querySelector('.compared').textContent)", 150_000);
    await tab.until("Number(/rms ([0-9.]+) %/.exec(document.querySelector('.compared').textContent)?.[1]) > 0.1");
    assert.ok(Number(said[2]) >= Number(said[1]), said[0]);
    assert.match(await tab.until("document.querySelector('.legend')?.innerText"), /difference/);
    if (PICTURES) writeFileSync(join(PICTURES, 'compared.png'), await tab.screenshot());
  });
  await onPage(`${site.url}/compare/a?compare=still`, (tab) => tab.until("/shows another surface/.test(document.querySelector('.compared').textContent)", 150_000));
  for (const sender of senders) await sender.stop('SIGKILL');
});

/** By the native viewer: the picture, and the capture time of what it shows. */
async function nativePicture(name, words) {
  const out = join(programs.folder, 'native'), record = join(programs.folder, 'shown.jsonl');
  const style = ['--normals=smooth', ...words.some((word) => word.startsWith('--colour=')) ? [] : ['--colour=clay']];
  const client = spawn(join(BIN, 'eigencast-client'), [`ws://127.0.0.1:${broker.port}/${name}`, '--headless', '--frames=1', '--rate=raw', `--size=${WIDTH}x${HEIGHT}`, `--out=${out}`, `--record-shown=${record}`, ...style, ...words],
    { stdio: ['ignore', 'ignore', 'inherit'], env: { ...process.env, EIGENCAST_CACHE: join(programs.folder, 'native-cache') } });
  const code = await new Promise((resolve) => client.on('exit', resolve));
  assert.equal(code, 0);
  const [shown] = readFileSync(record, 'utf8').trim().split('\n').map((line) => JSON.parse(line)).slice(-1);
  const png = readFileSync(join(out, 'frame_0001.png'));
  return { shown: String(shown.capture_us), png, picture: readPng(png) };
}

/** How similar the native viewer's picture is to each that the picture page in `tab` is asked for: [how, style]. */
async function compared(tab, name, words, ...asked) {
  const native = await nativePicture(name, words), similar = [];
  for (const [i, [how, style = {}]] of asked.entries()) {
    const made = await tab.evaluate(`window.take(${JSON.stringify(how)}, ${JSON.stringify(style)})`), png = Buffer.from(made.png, 'base64');
    assert.equal(made.shown, native.shown);
    if (PICTURES) writeFileSync(join(PICTURES, `web${words.slice(0, 1)}${how}${i}.png`), png), writeFileSync(join(PICTURES, `native${words.slice(0, 1)}.png`), native.png);
    similar.push(similarity(native.picture, readPng(png)));
  }
  return similar;
}
const WITH_CLIENT = { skip: existsSync(join(BIN, 'eigencast-client')) ? false : 'no eigencast-client' };

test('PicturesAreThoseOfTheNativeViewer', WITH_CLIENT, async () => {
  await onPage(`${site.url}/picture?stream=still`, async (tab) => {
    await tab.until('window.isReady()', 150_000);
    const both = (words, ...asked) => compared(tab, 'still', words, ...asked);
    const [same, flipped, shadowless] = await both(['--lod=1'], [''], ['flipped'], ['shadowless']);
    assert.ok(same.mean > 0.99 && same.worst > 0.9, `the same picture: ${JSON.stringify(same)}`);
    assert.ok(flipped.worst < 0.9, `flipped normals are seen: ${JSON.stringify(flipped)}`);
    assert.ok(shadowless.worst < 0.9, `a missing shadow is seen: ${JSON.stringify(shadowless)}`);
    const [points] = await both(['--points'], ['', { points: true }]);
    assert.ok(points.mean > 0.99, `points: ${JSON.stringify(points)}`);
    for (const colour of ['normals', 'own']) {
      const [coloured] = await both([`--colour=${colour}`], ['', { colour }]);
      assert.ok(coloured.mean > 0.99 && coloured.worst > 0.9, `${colour}: ${JSON.stringify(coloured)}`);
    }
    for (const [colourMap, range] of [['viridis'], ['turbo', [0.1, 0.5]]]) {
      const words = ['--colour=movement', `--colour-map=${colourMap}`, ...(range ? [`--colour-range=${range}`] : [])];
      const [numbers, otherMap] = await both(words, ['rebuilt', { colour: 'movement', colourMap, colourRange: range }], ['rebuilt', { colour: 'movement', colourMap: 'coolwarm', colourRange: range }]);
      assert.ok(numbers.mean > 0.99 && numbers.worst > 0.9, `movement: ${JSON.stringify(numbers)}`);
      assert.ok(otherMap.mean < numbers.mean - 0.001, `maps differ: ${JSON.stringify([numbers, otherMap])}`);
    }
    for (const lines of ['edges', 'wireframe']) {
      const [drawn, without] = await both([`--${lines}`], ['', { [lines]: true }], ['']);
      assert.ok(drawn.mean > 0.99 && drawn.mean > without.mean + 0.01, `${lines}: ${JSON.stringify([drawn, without])}`);
    }
  });
});

test('PicturesOfAStalledStreamShowAllOfIt', WITH_CLIENT, async () => {
  const sender = programs.ring(broker, 'dense', undefined, true, 4);
  await onPage(`${site.url}/picture?stream=dense`, async (tab) => {
    await tab.until('window.isReady() && view.live.surface.facts.rank === 48', 150_000);
    await sender.stop('SIGKILL');
    await tab.until("view.live.stream.status.state === 'stalled' && view.live.colourfulness(Date.now()) === 0");
    for (const lines of ['edges', 'wireframe']) {
      // Nothing of it is cached, so that it comes in parts.
      const [same] = await compared(tab, 'dense', [`--${lines}`, `--cache=${join(programs.folder, lines)}`], ['', { [lines]: true }]);
      assert.ok(same.mean > 0.99 && same.worst > 0.9, `${lines}: ${JSON.stringify(same)}`);
    }
  });
});

test('ImagesAreThoseOfTheNativeViewer', WITH_CLIENT, async () => {
  const image = makePng(64, 32, (x, y) => ((x >> 3) + (y >> 3)) % 2 ? [230, 40 + 3 * x, 30] : [40, 90, 40 + 6 * y]);
  programs.ring(broker, 'textured', image);
  await onPage(`${site.url}/picture?stream=textured`, async (tab) => {
    await tab.until("window.isReady() && view.colourings.includes('textured')", 150_000);
    const [same, plain] = await compared(tab, 'textured', ['--colour=textured'], ['rebuilt', { colour: 'textured' }], ['']);
    assert.ok(same.mean > 0.99 && same.worst > 0.9, `textured: ${JSON.stringify([same, plain])}`);
    assert.ok(plain.mean < 0.97, `its image is seen: ${JSON.stringify([same, plain])}`);
    await tab.evaluate('for (let i = 0; i < 5; ++i) view.coarser()');
    await tab.until(`view.vertices === ${Math.round(0.8 ** 5 * 960)}`);
    const [coarse] = await compared(tab, 'textured', ['--colour=textured', `--lod=${0.8 ** 5}`], ['rebuilt', { colour: 'textured' }]);
    assert.ok(coarse.mean > 0.99 && coarse.worst > 0.9, `textured and coarse: ${JSON.stringify(coarse)}`);
  });
  // With colours of its own as well: they are multiplied.
  programs.ring(broker, 'both', image, true);
  await onPage(`${site.url}/picture?stream=both`, async (tab) => {
    await tab.until("window.isReady() && view.colourings.includes('textured')", 150_000);
    const [same] = await compared(tab, 'both', ['--colour=textured'], ['rebuilt', { colour: 'textured' }]);
    assert.ok(same.mean > 0.99 && same.worst > 0.9, `image times colours: ${JSON.stringify(same)}`);
  });
});

test('TheCameraFollowsKeysAndPointers', async () => {
  await onPage(`${site.url}/still?rate=raw`, async (tab) => {
    await tab.until(`${hasState('live')} && ${CLAY} > 100`, 150_000);
    await tab.until("document.querySelector('canvas').style.touchAction === 'none'");  // Controls are loaded after the first picture.
    await tab.evaluate(`${button('pause')}.click()`);
    assert.equal(await tab.evaluate(`${button('pause')}.getAttribute('aria-pressed')`), 'true');
    await tab.evaluate('navigator.clipboard.writeText = async (text) => (window.copied = text)');
    // The link says where the camera is; the picture also changes with its level of detail.
    const hasMoved = async () => {
      await tab.evaluate('window.copied = undefined');
      await tab.key('i');
      return (await tab.until('window.copied')).includes('#eye=');
    };
    assert.equal(await hasMoved(), false);
    const moves = {
      arrow: () => tab.key('ArrowRight'), near: () => tab.key('PageUp'),
      drag: async () => {
        await tab.mouse('mousePressed', 200, 150, { button: 'left', buttons: 1, clickCount: 1 });
        await tab.mouse('mouseMoved', 260, 170, { button: 'left', buttons: 1 });
        await tab.mouse('mouseReleased', 260, 170, { button: 'left', clickCount: 1 });
      },
      touch: async () => {
        await tab.touch('touchStart', [200, 150]);
        await tab.touch('touchMove', [260, 180]);
        await tab.touch('touchEnd');
      },
      pinch: async () => {
        await tab.touch('touchStart', [200, 150], [280, 150]);
        await tab.touch('touchMove', [180, 150], [300, 150]);
        await tab.touch('touchEnd');
      },
      wheel: () => tab.mouse('mouseWheel', 240, 150, { deltaX: 0, deltaY: -200 }),
    };
    for (const [name, move] of Object.entries(moves)) {
      const before = await tab.evaluate(PRINT);
      await move();
      await tab.until(`${PRINT} !== ${before}`).catch((error) => assert.fail(`${name}: ${error.message}`));
      assert.ok(await until(hasMoved, name));
      await tab.key('r');
      assert.ok(await until(async () => !(await hasMoved()), `back from ${name}`));
    }
    await tab.key('h');
    assert.match(await tab.until("document.querySelector('dialog').open && document.querySelector('dialog').innerText"), /Space[\s\S]*pause: on/);
  });
});

test('FilmsAndScreenshotsAreKept', async () => {
  await onPage(`${site.url}/still?rate=raw`, async (tab) => {
    await tab.until(`${hasState('live')} && ${CLAY} > 100`, 150_000);
    await tab.evaluate(`(() => {
      const make = URL.createObjectURL.bind(URL);
      window.kept = [];
      URL.createObjectURL = (blob) => (kept.push(blob), make(blob));
      HTMLAnchorElement.prototype.click = function () { kept.at(-1).saved = this.download; };
    })()`);
    const first = (i) => tab.evaluate(`kept[${i}].slice(0, 4).arrayBuffer().then((bytes) => String(new Uint8Array(bytes)))`);
    await tab.key('s');
    await tab.until("kept.length === 1 && kept[0].saved === 'still.png'");
    assert.equal(await first(0), '137,80,78,71');
    await tab.key('k');
    await tab.until("/recording/.test(document.querySelector('.banner').textContent)");
    await tab.until(`${button('record a film')}.getAttribute('aria-pressed') === 'true'`);
    await new Promise((resolve) => setTimeout(resolve, 1500));
    await tab.key('k');
    await tab.until("kept.length === 2 && kept[1].saved === 'still.webm' && kept[1].size > 1000");
    assert.equal(await first(1), '26,69,223,163');
    await tab.until(`${button('record a film')}.getAttribute('aria-pressed') === 'false'`);
  });
});

test('HiddenPagesTakeNoPoses', async () => {
  programs.sender(broker, 'lab/moving', 'heart', '--rank', '24');
  await onPage(`${site.url}/picture?stream=lab/moving`, async (tab) => {
    const keys = 'view.live.stream.status.counts.keys + view.live.stream.status.counts.joins';
    const hide = (isHidden) => tab.evaluate(`Object.defineProperty(document, 'hidden', { configurable: true, get: () => ${isHidden} }); document.dispatchEvent(new Event('visibilitychange'))`);
    await tab.until(`window.isReady() && ${keys} > 3`, 150_000);
    await hide(true);
    await until(async () => {
      const before = await tab.evaluate(keys);
      await new Promise((resolve) => setTimeout(resolve, 1500));
      return before === await tab.evaluate(keys);
    }, 'no more poses');
    const before = await tab.evaluate(keys);
    await hide(false);
    await tab.until(`${keys} > ${before} && view.live.stream.status.state === 'live'`);
    assert.equal(await tab.evaluate('view.live.stream.status.reconnects'), 0);
  });
});

test('NumbersHaveALegend', async () => {
  await onPage(`${site.url}/still?rate=raw`, async (tab) => {
    await tab.until(`${hasState('live')} && ${CLAY} > 100`, 150_000);
    const legend = "document.querySelector('.legend')?.innerText ?? ''";
    for (let press = 0; press < 2; ++press) await tab.evaluate(`${button('what colours say')}.click()`);  // From its own colours to normals, to movement.
    await tab.until(`/movement from rest[^]*0.6\\+ units[^]*0$/.test(${legend})`);
    if (PICTURES) writeFileSync(join(PICTURES, 'legend.png'), await tab.screenshot());
    const print = await tab.evaluate(PRINT);
    await tab.key('c');
    await tab.until(`${PRINT} !== ${print}`);
    await tab.key('b');
    await tab.until(`${legend} === ''`);
    await tab.key('b');
    await tab.key('v');
    await tab.until(`/^speed[^]*units.s/.test(${legend})`);
    await tab.key('v');
    await tab.until(`${legend} === ''`);
  });
});

test('TheListShowsEachStream', async () => {
  await onPage(`${site.url}/`, async (tab) => {
    await tab.until("[...document.querySelectorAll('.streams dt')].some((name) => name.textContent === 'still')");
    await tab.until(`${CLAY} > 50`);
    assert.equal(await tab.evaluate("[...document.querySelectorAll('.streams a')].find((a) => a.textContent.includes('still')).href"), `${site.url}/still`);
  });
});

test('AWallOfStreamsTakesOneConnectionAndOneContext', async () => {
  const own = await programs.broker(), stop = await publishWall(programs, own, 30, 'heart', '--rank', '24'), wall = await startSite(own.port), tab = await chromium.tab();
  try {
    await tab.size(800, 500);
    await tab.preload(COUNTS);
    await tab.open(`${wall.url}/?wall=1`);
    await tab.until('pictures().length === 30 && pictures().every((count) => count > 0)', 150_000);
    const drawn = JSON.stringify(await tab.evaluate('pictures()'));
    await tab.until(`pictures().every((count, i) => count > ${drawn}[i] + 5)`);
    if (PICTURES) writeFileSync(join(PICTURES, 'wall.png'), await tab.screenshot());
    assert.deepEqual([wall.counted.connections, await tab.evaluate('contexts')], [1, 1]);
    assert.equal(await tab.evaluate('document.documentElement.scrollHeight'), 500, 'all of them are in the window');
    await tab.evaluate("document.querySelector('.list form [aria-pressed]').click()");
    await tab.until("document.querySelectorAll('.streams canvas').length < 30");  // Far out of sight nothing is taken.
    if (PICTURES) writeFileSync(join(PICTURES, 'list.png'), await tab.screenshot());
    await tab.evaluate(`document.querySelector('.list input').value = 'wall/3'; document.querySelector('.list form').requestSubmit()`);
    await tab.until(`location.href === '${wall.url}/wall/3' && ${hasState('live')}`);
    assert.deepEqual(tab.console, []);
  } finally {
    stop();
    await tab.close();
    await wall.stop();
    await own.stop();
  }
});

test('TokensLeaveTheAddressAndAreAskedForWhereTheyAreMissing', async () => {
  const made = spawnSync(join(BIN, 'eigencast-broker'), ['token', 'create', '--static', '--subject=viewer', '--subscribe=lab/*'], { encoding: 'utf8' });
  const tokens = join(programs.folder, 'tokens'), token = made.stdout.trim();
  writeFileSync(tokens, `${made.stderr.trim().split('\n').at(-1)}\n`, { mode: 0o600 });
  const closed = await programs.broker(0, '--access-anonymous=nowhere', `--access-tokens-file=${tokens}`);
  const gate = await startSite(closed.port, { prefix: '/behind/a/proxy' });
  const tab = await chromium.tab();
  await tab.open(`${gate.url}/lab/x#access_token=${token}`);
  await tab.until(hasState('waiting'));
  assert.equal(await tab.evaluate('location.href'), `${gate.url}/lab/x`);
  await tab.close();
  const stranger = await chromium.tab();
  await stranger.open(`${gate.url}/lab/x`);
  await stranger.until("/takes a token/.test(document.querySelector('.note').innerText)");
  await stranger.evaluate(`(() => { document.querySelector('.note input').value = ${JSON.stringify(token)}; document.querySelector('.note form').requestSubmit(); })()`);
  await stranger.until(hasState('waiting'));
  assert.equal(await stranger.evaluate('location.href'), `${gate.url}/lab/x`);
  await stranger.close();
  await gate.stop();
});

test('AddressesThatCannotBeMeantAreRefusedWithWords', async () => {
  for (const [path, said] of [['/not%20a%20name', /stream name "not a name"/], ['/%zz', /cannot start/], ['/still?rate=fast', /rate is 'fast'; known: raw/]]) {
    const tab = await chromium.tab();
    await tab.open(site.url + path);
    assert.match(await tab.until("document.querySelector('.note')?.innerText"), said);
    await tab.close();
  }
});

test('WhatIsLostComesBack', async () => {
  await onPage(`${site.url}/picture?stream=still`, async (tab) => {
    await tab.until('window.isReady()', 150_000);
    await tab.evaluate("(window.loser = stage.gl.getExtension('WEBGL_lose_context')).loseContext()");
    await tab.until('stage.renderer === undefined');
    await tab.evaluate('window.loser.restoreContext()');
    await tab.until(`stage.renderer !== undefined && (view.invalidate(), ${CLAY} > 100)`);
    tab.console.length = 0;  // Chromium says that a context was lost.
    await tab.evaluate("document.querySelector('canvas').getContext('2d').clearRect(0, 0, 9999, 9999)");
    site.cut();
    await tab.until("view.live.stream.status.reconnects === 1 && view.live.stream.status.state === 'live'");
    await tab.until(`(view.invalidate(), ${CLAY} > 100)`);
  });
});

test('ElementsShowStreamsInPagesOfOtherOrigins', async () => {
  const open = await programs.broker(0, '--access-origins=*'), itsSite = await startSite(open.port);
  programs.ring(open, 'still');
  const element = (name, more = '') => `<eigencast-view src="${itsSite.url}/${name}?rate=raw" ${more}></eigencast-view>`;
  const page = `<!doctype html><html lang="en"><title>anybody's</title><style>eigencast-view { width: 200px; }</style>
    <script type="module" src="${itsSite.url}/v1/web/element.js"></script><body>${element('still')}${element('still', 'colour="normals" still')}${element('not/there')}</body></html>`;
  const other = await startSite(open.port, { pages: { '/': page }, hasPolicy: false });
  await onPage(`${other.url}/`, async (tab) => {
    await tab.until(`${CLAY} > 200`, 150_000);
    await tab.until("document.querySelectorAll('eigencast-view')[1].view?.vertices === 960");
    await tab.until("/waiting for a sender/.test(document.querySelectorAll('eigencast-view')[2].shadowRoot.textContent)");
    // Another stream, and none.
    await tab.evaluate("document.querySelectorAll('eigencast-view')[2].setAttribute('src', document.querySelector('eigencast-view').getAttribute('src'))");
    await tab.until("document.querySelectorAll('eigencast-view')[2].view?.vertices === 960");
    await tab.evaluate("document.body.replaceChildren()");
  });
  await other.stop();
  await itsSite.stop();
});

test('PagesPublishWhatOthersSee', async () => {
  const code = `
    import { connect } from '/v1/web/eigencast.js';
    import { publish } from '/v1/web/publisher.js';
    const listed = await (await connect(location.origin)).streams();
    window.publisher = await publish(location.origin + '/play/ring', { asset: listed.find(({ stream }) => stream === 'still').asset });
    window.width = 1;
    setInterval(() => publisher.send(publisher.rest.map((value, i) => (i % 3 === 0 ? width * value : value))), 50);`;
  const own = await startSite(broker.port, { pages: { '/player': '<!doctype html><html lang="en"><title>player</title><script type="module" src="/player.js"></script><body></body></html>', '/player.js': code } });
  await onPage(`${own.url}/player`, async (player) => {
    await player.until("publisher.status.state === 'live' && publisher.sent > 3", 150_000);
    await onPage(`${own.url}/play/ring`, async (tab) => {
      await tab.until(`${hasState('live')} && ${CLAY} > 100`, 150_000);
      await player.until('publisher.status.subscribers === 1');
      const before = await tab.evaluate(CLAY);
      await player.evaluate('void (window.width = 0.4)');
      await tab.until(`${CLAY} < ${0.8 * before}`);
    });
  });
  await own.stop();
});

/** What axe finds on a page, in its words. */
const AXE = fileURLToPath(new URL('../../node_modules/axe-core/axe.min.js', import.meta.url));
async function violations(tab) {
  await tab.evaluate(`${readFileSync(AXE, 'utf8')}; undefined`);
  return tab.evaluate("axe.run(document, { resultTypes: ['violations'] }).then(({ violations }) => violations.map(({ id, nodes }) => `${id}: ${nodes.map(({ html, failureSummary }) => `${html} ${failureSummary}`).join('; ')}`))");
}

test('NoPageIsInTheWayOfAssistiveTechnology', { skip: !existsSync(AXE) && 'no axe-core: `npm ci` in web/' }, async () => {
  const isLive = "document.querySelector('.state.live')";
  const pages = [
    ['/', isLive], ['/?wall=1', isLive], ['/still', hasState('live')], ['/still?embed=1', hasState('live')], ['/lab/nobody', "/Waiting/.test(document.querySelector('.note')?.innerText)"],
    ['/not%20a%20name', "/cannot start/.test(document.body.innerText)"],
    ['/still', `${hasState('live')} && (document.querySelector('dialog').open || (document.querySelector('button[aria-label="this help"]').click(), false)) && document.querySelector('dialog h2, dialog dt, dialog td')`],
  ];
  const found = {};
  for (const scheme of ['light', 'dark']) {
    for (const [path, isThere] of pages) {
      const tab = await chromium.tab();
      try {
        await tab.size(960, 600);
        await tab.media({ 'prefers-color-scheme': scheme });
        await tab.open(site.url + path);
        await tab.until(isThere);
        const said = await violations(tab);
        if (said.length > 0) found[`${path}, ${scheme}`] = said;
      } finally {
        await tab.close();
      }
    }
  }
  assert.deepEqual(found, {});
});

test('KeysAloneReachEverything', async () => {
  await onPage(`${site.url}/still`, async (tab) => {
    await tab.until(`${hasState('live')} && document.querySelector('.tools button')`);
    const controls = await tab.evaluate("[...document.querySelectorAll('a[href], button, input, canvas[tabindex]')].filter((one) => one.checkVisibility()).map((one) => one.matches('canvas') ? 'canvas' : one.ariaLabel)");
    const met = [];
    for (let i = 0; i < controls.length; ++i) {
      await tab.key('Tab');
      met.push(await tab.evaluate("(() => { const one = document.activeElement; return !one.matches(':focus-visible') ? `${one.tagName} without a mark` : one.matches('canvas') ? 'canvas' : one.ariaLabel; })()"));
    }
    assert.deepEqual(met.toSorted(), controls.toSorted());
    await tab.evaluate("document.querySelector('button[aria-label=\"this help\"]').focus()");
    await tab.key('Enter');
    await tab.until("document.querySelector('dialog').open && document.querySelector('dialog').contains(document.activeElement)");
    await tab.key('Escape');
    await tab.until("!document.querySelector('dialog').open && document.activeElement.ariaLabel === 'this help'");
  }, { size: [960, 600] });
});

test('EmbeddedPagesHaveNoControls', async () => {
  await onPage(`${site.url}/still?embed=1`, async (tab) => {
    await tab.until(`${CLAY} > 100`, 150_000);
    assert.equal(await tab.evaluate("getComputedStyle(document.querySelector('.tools')).display"), 'none');
    assert.equal(await tab.evaluate("document.querySelector('.open').href"), `${site.url}/still`);
  });
});
