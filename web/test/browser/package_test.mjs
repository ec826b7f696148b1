// SPDX-License-Identifier: MIT
//
// The package as npm installs it from its archive: what is in it, in Node, in bundles of one's own (web/examples) and in
// Chromium, with a real broker and real senders (EIGENCAST_BIN).
import assert from 'node:assert/strict';
import { execFile, spawn } from 'node:child_process';
import { cpSync, existsSync, mkdirSync, mkdtempSync, readdirSync, readFileSync, rmSync, symlinkSync, writeFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { promisify } from 'node:util';
import { gzipSync } from 'node:zlib';
import { BIN, Programs } from '../system/programs.mjs';
import { freePort, until } from '../unit/fake_broker.mjs';
import { BUILD, ROOT } from '../unit/support.mjs';
import { CHROMIUM, startChromium } from './chromium.mjs';
import { makePng, readPng } from './pictures.mjs';
import { startSite } from './site.mjs';

const run = promisify(execFile), WEB = join(ROOT, 'web'), MODULES = join(WEB, 'examples/node_modules');
const LIMIT_MS = Number(process.env.EIGENCAST_LIMIT_MS ?? 150_000);
const PICTURES = process.env.EIGENCAST_PICTURES;
if (!existsSync(MODULES)) {
  console.log('no modules of web/examples: deploy/install-packages.sh');
  process.exit(77);
}
const { build } = createRequire(join(WEB, 'build.mjs'))('esbuild');
const folder = mkdtempSync(join(tmpdir(), 'eigencast-package-test-')), own = join(folder, 'own');
const installed = join(own, 'node_modules/eigencast'), dist = (file) => readFileSync(join(installed, 'dist', file));
const programs = new Programs(), pages = {};
let packed, broker, site, cdn, chromium;

before(async () => {
  await run(process.execPath, [join(WEB, 'pack.mjs'), BUILD, folder]);
  [packed] = readdirSync(folder).filter((name) => name.endsWith('.tgz'));
  mkdirSync(own);
  writeFileSync(join(own, 'package.json'), '{ "private": true, "type": "module" }');
  await run('npm', ['install', '--offline', '--no-audit', '--no-fund', '--ignore-scripts', join(folder, packed)], { cwd: own });
  for (const name of readdirSync(MODULES)) if (!name.startsWith('.')) symlinkSync(join(MODULES, name), join(own, 'node_modules', name));
  for (const name of readdirSync(join(WEB, 'examples'))) if (/\.(js|html)$/.test(name)) cpSync(join(WEB, 'examples', name), join(own, name));
  await build({ entryPoints: ['three', 'react', 'babylon'].map((name) => join(own, `${name}.js`)), bundle: true, format: 'esm', minify: true, outdir: join(own, 'built'), logLevel: 'error', define: { 'process.env.NODE_ENV': '"development"' } });
  broker = await programs.broker(0, '--access-origins=*');
  programs.ring(broker, 'still');
  programs.ring(broker, 'textured', makePng(64, 32, (x, y) => ((x >> 3) + (y >> 3)) % 2 ? [230, 40 + 3 * x, 30] : [40, 90, 40 + 6 * y]));
  programs.cloud(broker, 'points');
  site = await startSite(1, { pages, hasPolicy: false });
  cdn = await startSite(1, { pages: { '/inline.js': String(dist('inline.js')) }, hasPolicy: false });
  for (const name of ['three', 'react', 'babylon']) pages[`/${name}.html`] = readFileSync(join(own, `${name}.html`), 'utf8');
  for (const name of readdirSync(join(own, 'built'))) pages[`/built/${name}`] = readFileSync(join(own, 'built', name), 'utf8');
  if (CHROMIUM) chromium = await startChromium();
});
after(async () => {
  await chromium?.stop();
  await cdn?.stop();
  await site?.stop();
  programs.stop();
  rmSync(folder, { recursive: true, force: true });
});

const IN_BROWSER = { skip: CHROMIUM ? false : 'no Chromium: deploy/install-packages.sh full' };
const streamUrl = (name) => `http://127.0.0.1:${broker.port}/${name}`;
/** A tab of its own; a page that says something on its console fails its test. */
async function onPage(path, use, usual = /Babylon\.js v|React DevTools/) {
  const tab = await chromium.tab();
  try {
    await tab.size(480, 300);
    await tab.open(new URL(path, site.url).href);
    await use(tab);
    assert.deepEqual(tab.console.filter((line) => !usual.test(line)), []);
  } catch (error) {
    throw new Error(`${error.message}; console: ${tab.console.join(' | ')}`);
  } finally {
    await tab.close();
  }
}
/** Until so many pixels of the page are as `isWanted(r, g, b)` says. */
async function untilPixels(tab, name, count, isWanted) {
  for (const end = Date.now() + LIMIT_MS, seen = []; ; ) {
    const png = await tab.screenshot().catch(() => undefined);  // Nothing between two pages.
    if (!png) continue;
    const { rgb } = readPng(png);
    let found = 0;
    for (let i = 0; i < rgb.length; i += 3) found += isWanted(rgb[i], rgb[i + 1], rgb[i + 2]);
    seen.push(found);
    if (PICTURES) writeFileSync(join(PICTURES, `package-${name}.png`), png);
    if (found > count) return found;
    if (Date.now() > end) assert.fail(`${name}: pixels seen: ${seen.slice(-5)}; title: ${await tab.evaluate('document.title')}`);
  }
}
const isClay = (r, g, b) => r > b + 40, isColoured = (r, g, b) => Math.max(r, g, b) - Math.min(r, g, b) > 60;

test('TheArchiveHoldsThePackageAndNothingElse', () => {
  const { version } = JSON.parse(readFileSync(join(WEB, 'package.json'), 'utf8'));
  const [, whole] = /project\(eigencast VERSION (\S+)/.exec(readFileSync(join(ROOT, 'CMakeLists.txt'), 'utf8'));
  assert.equal(version, whole);
  assert.equal(packed, `eigencast-${version}.tgz`);
  const files = readdirSync(installed, { recursive: true }).map((name) => name.replaceAll('\\', '/'));
  const rooms = ['adapter', 'babylon', 'client', 'core', 'element', 'inline', 'parts', 'publisher', 'react', 'three', 'view'];
  const others = files.filter((name) => !/^dist\/eigencast-\w{8}\.js$/.test(name) && !rooms.some((room) => new RegExp(`^dist/types/${room}(/\\w+\\.d\\.ts)?$`).test(name)));
  assert.deepEqual(others.sort(), [
    'LICENSE', 'README.md', 'dist', 'dist/babylon.js', 'dist/eigencast-core.wasm', 'dist/eigencast-levels.wasm', 'dist/eigencast-writer.wasm', 'dist/eigencast.js', 'dist/element.js', 'dist/inline.js',
    'dist/parts.js', 'dist/publisher.js', 'dist/react.js', 'dist/three.js', 'dist/types', 'dist/view.js', 'dist/worker.js', 'package.json',
  ]);
  const manifest = JSON.parse(readFileSync(join(installed, 'package.json'), 'utf8'));
  assert.equal(manifest.dependencies, undefined);
  assert.ok(Object.keys(manifest.peerDependencies).every((name) => manifest.peerDependenciesMeta[name].optional));
  for (const entry of Object.values(manifest.exports).flatMap((one) => (typeof one === 'string' ? [one] : Object.values(one)))) assert.ok(existsSync(join(installed, entry)), entry);
});

test('SizesAreThoseOfTheManual', () => {
  const most = { 'inline.js': 147_000, 'parts.js': 107_000, 'three.js': 3000, 'react.js': 1000, 'babylon.js': 2000 };
  const size = (file) => gzipSync(dist(file), { level: 9 }).length;
  const sizes = Object.fromEntries(Object.keys(most).map((file) => [file, size(file)]));
  // With what it brings: the others share theirs.
  for (const [, chunk] of String(dist('parts.js')).matchAll(/from"\.\/(eigencast-\w+\.js)"/g)) sizes['parts.js'] += size(chunk);
  console.log(`compressed: ${JSON.stringify(sizes)}`);
  for (const [file, size] of Object.entries(sizes)) assert.ok(size <= most[file], `${file}: ${size} bytes`);
});

test('ProgramsInNodeTakeTheClient', async () => {
  writeFileSync(join(own, 'list.js'), `
    import { readFile } from 'node:fs/promises';
    import { createRequire } from 'node:module';
    import { connect } from 'eigencast';
    const core = await readFile(createRequire(import.meta.url).resolve('eigencast/core.wasm'));
    const broker = await connect('http://127.0.0.1:${broker.port}', { core, worker: false });
    while (!(await broker.streams()).some(({ stream, state }) => stream === 'still' && state === 'live')) await new Promise((resolve) => setTimeout(resolve, 50));
    console.log('found');
    process.exit(0);`);
  const { stdout } = await run(process.execPath, [join(own, 'list.js')], { timeout: 120_000 });
  assert.equal(stdout.trim(), 'found');
});

test('TypesFitThoseOfOtherPackages', async () => {
  writeFileSync(join(own, 'typed.tsx'), `
    import { Mesh as BabylonMesh, type Scene as BabylonScene } from 'babylonjs';
    import { createElement } from 'react';
    import { Scene, type Mesh, type WebGLRenderer } from 'three';
    import { connect, type Status } from 'eigencast';
    import { EigencastSurface } from 'eigencast/babylon';
    import { EigencastView } from 'eigencast/react';
    import { EigencastMesh } from 'eigencast/three';
    import { connect as connectInline } from 'eigencast/inline';
    export function shows(scene: Scene, other: BabylonScene, renderer: WebGLRenderer): unknown {
      const horse: Mesh = new EigencastMesh('https://host/lab/horse', { detail: 0.5, profile: { rate: 'raw' } }), ball = new EigencastMesh('x');
      scene.add(horse, ball);
      ball.addEventListener('status', ({ status }) => { const said: Status = status; return said.detail; });
      ball.update(renderer);
      new EigencastSurface(new BabylonMesh('horse', other), 'https://host/lab/horse').on('error', ({ code }) => code.length);
      // @ts-expect-error: a stream has a URL
      createElement(EigencastView, {});
      return [connect('https://host'), connectInline('https://host'), createElement(EigencastView, { src: 'https://host/lab/horse', onStatus: ({ state }) => state })];
    }`);
  const options = ['--strict', '--noEmit', '--skipLibCheck', '--module', 'esnext', '--moduleResolution', 'bundler', '--target', 'es2022', '--jsx', 'react-jsx'];
  const { stdout } = await run(process.execPath, [join(WEB, 'node_modules/typescript/bin/tsc'), ...options, 'typed.tsx'], { cwd: own }).catch((error) => error);
  assert.equal(stdout, '');
});

test('AMeshOfThreeMovesWithItsStream', IN_BROWSER, async () => {
  await onPage(`/three.html?stream=${streamUrl('still')}`, async (tab) => {
    await untilPixels(tab, 'three', 3000, isColoured);
    const state = await tab.until("shown.horse.status?.state === 'live' && shown.horse.geometry.getAttribute('position').count === 960 && shown.horse.geometry.hasAttribute('color') && { ...shown.horse.geometry.boundingSphere }");
    assert.ok(state.radius > 1 && state.radius < 2, `a ring of 1.4: ${JSON.stringify(state)}`);
    // Under the middle of the ring's tube, and beside it.
    const hits = await tab.evaluate(`(async () => {
      const { Raycaster, Vector3 } = shown.three, cast = (x, z) => new Raycaster(new Vector3(x, 9, z), new Vector3(0, -1, 0)).intersectObject(shown.scene, true);
      return [cast(1, 0), cast(0, 0), cast(5, 0)].map((hits) => hits.map(({ distance, face }) => [distance, face !== null]));
    })()`);
    assert.ok(hits[0].length >= 2 && hits[0][0][1] && hits[0][0][0] < 9, JSON.stringify(hits));
    assert.deepEqual(hits.slice(1), [[], []]);
    const before = await tab.evaluate('shown.renderer.info.memory.geometries');
    await tab.evaluate('shown.horse.detail = 0.5');
    await tab.until("shown.horse.geometry.getAttribute('position').count === 480");
    await tab.evaluate('void (shown.horse.dispose(), shown.scene.remove(shown.horse))');
    await tab.until(`shown.renderer.info.memory.geometries === ${before - 1}`);
  });
});

test('ImagesAreTexturesInThree', IN_BROWSER, async () => {
  await onPage(`/three.html?stream=${streamUrl('textured')}`, async (tab) => {
    await tab.until("shown.horse.material.map !== null && shown.horse.geometry.hasAttribute('uv')", 150_000);
    await untilPixels(tab, 'textured', 500, (r, g, b) => b > r + 60);
  });
});

test('PointsAreDiscsInThree', IN_BROWSER, async () => {
  await onPage(`/three.html?stream=${streamUrl('points')}`, async (tab) => {
    await untilPixels(tab, 'points', 2000, isClay);
    const hit = await tab.evaluate(`(() => {
      const { Raycaster, Vector3 } = shown.three, [x, y, z] = shown.horse.geometry.getAttribute('centre').array;
      const ray = new Raycaster(new Vector3(x, y + 9, z), new Vector3(0, -1, 0)), hits = ray.intersectObject(shown.horse);
      return { count: hits.length, ...hits[0]?.point, y0: y, radius: shown.horse.geometry.boundingSphere.radius };
    })()`);
    assert.ok(hit.count === 1 && hit.y >= hit.y0 - 0.2 && hit.radius > 1 && hit.radius < 2.5, JSON.stringify(hit));
  });
});

test('ReactShowsStreams', IN_BROWSER, async () => {
  await onPage(`/react.html?stream=${streamUrl('still')}`, async (tab) => {
    await untilPixels(tab, 'react', 3000, isColoured);
    await tab.until("document.title === 'live'");
    await tab.evaluate("void (window.element = document.querySelector('eigencast-view'), shown.root.unmount())");
    await tab.until('!document.querySelector("eigencast-view") && element.view === undefined');
  });
});

test('AMeshOfBabylonMovesWithItsStream', IN_BROWSER, async () => {
  await onPage(`/babylon.html?stream=${streamUrl('still')}`, async (tab) => {
    await untilPixels(tab, 'babylon', 3000, isColoured);
    await tab.until('shown.mesh.getTotalVertices() === 960 && shown.mesh.getIndices().length > 5000');
    const { radius } = await tab.evaluate('({ radius: shown.mesh.getBoundingInfo().boundingSphere.radius })');
    assert.ok(radius > 1 && radius < 3, String(radius));
    const watching = async () => (await (await fetch(`http://127.0.0.1:${broker.port}/v1/streams`)).json()).streams.find(({ stream }) => stream === 'still').subscribers;
    await until(async () => (await watching()) === 1, 'one viewer: the page before has left');
    await tab.evaluate('void shown.mesh.dispose()');
    await until(async () => (await watching()) === 0, 'no viewer');
  });
  await onPage(`/babylon.html?stream=${streamUrl('textured')}`, (tab) => untilPixels(tab, 'babylon-textured', 500, (r, g, b) => b > r + 60));
  await onPage(`/babylon.html?stream=${streamUrl('points')}`, (tab) => untilPixels(tab, 'babylon-points', 1000, isClay));
});

test('WhatTheManualSaysWorks', IN_BROWSER, async () => {
  const place = join(folder, 'manual'), port = await freePort(), other = await freePort();
  mkdirSync(place);
  const env = { ...process.env, PATH: `${BIN}:${join(WEB, 'node_modules/.bin')}:${process.env.PATH}`, XDG_CACHE_HOME: join(place, 'cache'), XDG_STATE_HOME: join(place, 'state') };
  const manual = readFileSync(join(ROOT, 'docs/web.md'), 'utf8').replaceAll('localhost:7490', `127.0.0.1:${port}`).replaceAll('localhost:8000', `127.0.0.1:${other}`).replaceAll('http.server 8000', `http.server ${other} --bind 127.0.0.1`);
  // Files, named before their fences, and commands, in the order of the page.
  const steps = [...manual.matchAll(/^`(\w+\.\w+)`[^`]*(?:`[^`]*`:)?\s*^```\w+\n([^]*?)^```|^ {4}(\w.*)$/gm)], running = [];
  assert.equal(steps.length, 8, 'has the page another form?');
  try {
    for (const [, file, text, command] of steps) {
      if (file) writeFileSync(join(place, file), text);
      else if (command.startsWith('npm install')) cpSync(join(own, 'node_modules'), join(place, 'node_modules'), { recursive: true });
      else if (command.endsWith('&')) {
        const tested = command.replace('eigencast-broker', `eigencast-broker --listen 127.0.0.1:${port} --admin-listen '' --data-dir data`).replace('play heart', 'play heart --no-progress --rank 24');
        running.push(spawn('sh', ['-c', `exec ${tested.slice(0, -1)}`], { cwd: place, env, stdio: 'ignore' }));
      } else await run('sh', ['-c', command.replace('npx ', '')], { cwd: place, env });
    }
    for (const name of ['element', 'scene']) await onPage(`http://127.0.0.1:${other}/${name}.html`, (tab) => untilPixels(tab, `manual-${name}`, 1000, isClay), /favicon/);
  } finally {
    for (const one of running) one.kill('SIGKILL');
  }
});

const onInlinePage = (name) => readFileSync(join(own, 'inline.html'), 'utf8').replace('node_modules/eigencast/dist/', `${cdn.url}/`).replace('http://localhost:7490/demo', streamUrl(name));

test('OneFileOfAnotherOriginIsEnough', IN_BROWSER, async () => {
  pages['/inline.html'] = onInlinePage('still');
  await onPage('/inline.html', async (tab) => {
    await untilPixels(tab, 'inline', 3000, isClay);
    const loaded = await tab.evaluate("performance.getEntriesByType('resource').map(({ name }) => new URL(name).origin + ' ' + new URL(name).pathname)");
    assert.deepEqual(loaded.filter((one) => /\.(js|wasm|css)$/.test(one)), [`${cdn.url} /inline.js`]);
  });
});

test('OneFileShowsWhatAStreamLearns', IN_BROWSER, async () => {
  pages['/learn.html'] = onInlinePage('tube');
  const sender = programs.tube(broker, 'tube');
  try {
    await onPage('/learn.html', async (tab) => {
      await tab.until("document.querySelector('eigencast-view').stream?.surface?.facts.rank > 40", LIMIT_MS);  // What it was baked with.
      await untilPixels(tab, 'learn', 1000, isClay);
    });
  } finally {
    await sender.stop();
  }
});
