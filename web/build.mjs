// SPDX-License-Identifier: MIT
//
// build.mjs [OUT]: bundles into OUT (default: dist) what a broker serves: eigencast.js, view.js, element.js, publisher.js,
// worker.js and player.js; the page: page.html, page.css and page.js; show.html, a page in one file that plays
// recordings; and internals.js for tests. Types are checked by tsc.
// build.mjs --package OUT: the package for npm, into the folder with its wasm: the same but the page, its worker in one
// file, so that bundlers may take it elsewhere, adapters, and parts.js and inline.js, which hold worker and wasm.
//
// {web} in page.html stands for the path from the page to the folder of these files, whose path holds /v1/web/: who
// serves the page fills it in.
import { createHash } from 'node:crypto';
import { build } from 'esbuild';
import { existsSync, readFileSync, readdirSync, rmSync, writeFileSync } from 'node:fs';
import { basename, join } from 'node:path';
import { fileURLToPath } from 'node:url';
import { deflateSync } from 'node:zlib';
import { nativeShaders } from './shaders.mjs';

const here = (path) => fileURLToPath(new URL(path, import.meta.url));
const isPackage = process.argv[2] === '--package';
const outdir = process.argv[isPackage ? 3 : 2] ?? here('dist');
const worker = { worker: here('src/worker/index.ts') };

/**
 * `inline:NAME`: the wasm of OUT, deflated, in base64, or the worker in one file. The columns' wasm in it is that of the
 * script that holds it, so that a script has it once.
 */
const COLUMNS = 'eigencast-columns.wasm', PLACE = `{${COLUMNS}}`;
const inlinedAs = (wasm) => ({
  name: 'inlined',
  setup(plugin) {
    plugin.onResolve({ filter: /^inline:/ }, ({ path }) => ({ path: path.slice('inline:'.length), namespace: 'inline' }));
    plugin.onLoad({ filter: /\.wasm$/, namespace: 'inline' }, ({ path }) => wasm(path));
    for (const [filter, entryPoints, format = 'esm'] of [[/^worker\.js$/, worker], [/^player\.js$/, { player: here('src/recording/worker.ts') }, 'iife']]) {
      plugin.onLoad({ filter, namespace: 'inline' }, async () => {
        const plugins = [nativeShaders, inlinedAs(() => ({ contents: PLACE, loader: 'text' }))];
        const [{ text }] = (await build({ ...options, plugins, format, entryPoints, write: false })).outputFiles;
        if (text.split(PLACE).length !== 2) throw new Error(`${entryPoints}: not one place for ${COLUMNS}`);
        return { contents: `import wasm from 'inline:${COLUMNS}'; export default ${JSON.stringify(text)}.replace('${PLACE}', wasm);` };
      });
    }
  },
});
const inlined = inlinedAs((path) => ({ contents: deflateSync(readFileSync(join(outdir, path)), { level: 9 }), loader: 'base64' }));
const options = {
  outdir,
  bundle: true,
  minify: true,
  format: 'esm',
  target: 'es2022',
  legalComments: 'inline',
  logLevel: 'warning',
  external: ['three', 'react'],
  plugins: [nativeShaders, inlined],
};
/** Page, worker and modules in one file, to which `eigencast-sender export` adds a recording: {recording}. It runs nothing else. */
async function onePage() {
  const made = async (path) => (await build({ ...options, entryPoints: [here(path)], write: false })).outputFiles[0].text.trim();
  const script = (await made('src/recording/index.ts')).replaceAll('</script', '<\\/script').replaceAll('<!--', '<\\!--');
  const style = (await made('src/page/page.css')) + (await made('src/recording/recording.css'));
  const hash = (text) => `'sha256-${createHash('sha256').update(text).digest('base64')}'`;
  const policy = `default-src 'none'; script-src ${hash(script)} 'wasm-unsafe-eval'; style-src ${hash(style)}; img-src data: blob:; worker-src blob:; connect-src 'self'; base-uri 'none'; form-action 'none'`;
  const parts = { policy, style, script };
  return readFileSync(here('src/recording/index.html'), 'utf8').replace(/\{(policy|style|script)\}/g, (_, name) => parts[name]);
}
/** What page and worker share is one file, for they wait for each: what is loaded later has copies of its own of what would make it several. */
const fewFiles = {
  name: 'few-files',
  setup(plugin) {
    plugin.onResolve({ filter: /\/(matrix|module)\.js$/ }, ({ path, importer, resolveDir }) =>
      /\/(controls|learnt|list|memory|pick|query|room|sync)\.ts$/.test(importer) ? { path: join(resolveDir, path).replace(/js$/, 'ts'), suffix: '?later' } : undefined);
    // The page's session is in its worker, that of a recording in a file of its own.
    for (const [filter, path] of [[/\/session\.js$/, './worker.js'], [/\/recording\/worker\.js$/, './player.js']]) plugin.onResolve({ filter }, ({ kind }) => (kind === 'dynamic-import' ? { path, external: true } : undefined));
  },
};
for (const old of existsSync(outdir) ? readdirSync(outdir) : []) if (/^eigencast-\w{8}\.js$/.test(old)) rmSync(join(outdir, old));
// What page and worker share is loaded once, and so is what the entries of the package share.
const split = { ...options, splitting: true, chunkNames: 'eigencast-[hash]', metafile: true };
const entriesOf = (...names) => Object.fromEntries(names.map((name) => [name, here(`src/${name}/index.ts`)]));
const entries = { eigencast: here('src/client/index.ts'), ...entriesOf('view', 'element', 'publisher', ...(isPackage ? ['three', 'react', 'babylon', 'parts'] : [])) };
await build({ ...split, entryPoints: entries });
if (isPackage) {
  await build({ ...options, entryPoints: { ...worker, ...entriesOf('inline') } });
} else {
  const { metafile } = await build({ ...split, entryPoints: { page: here('src/page/page.ts'), ...worker }, plugins: [...options.plugins, fewFiles] });
  await build({ ...options, entryPoints: { internals: here('src/internals.ts'), player: here('src/recording/worker.ts') } });
  await build({ ...options, entryPoints: { page: here('src/page/page.css') } });
  // The worker takes what the page has fetched, too.
  const loaded = Object.entries(metafile.outputs).filter(([, { entryPoint }]) => /src\/(page\/page|worker\/index)\.ts$/.test(entryPoint));
  const files = new Set(loaded.flatMap(([path, { imports }]) => [path, ...imports.filter(({ kind }) => kind === 'import-statement').map((one) => one.path)]).map((path) => basename(path)));
  const chunks = [...files].filter((file) => file !== 'page.js').map((file) => `<link rel="modulepreload" href="{web}${file}">`);
  const page = readFileSync(here('src/page/index.html'), 'utf8').replace('<!-- {preload} -->', chunks.join('\n'));
  writeFileSync(join(outdir, 'page.html'), page.replace(/\n+/g, '\n'));
  writeFileSync(join(outdir, 'show.html'), await onePage());
}
