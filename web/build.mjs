// SPDX-License-Identifier: MIT
//
// build.mjs [OUT]: bundles into OUT (default: dist) what a broker serves: eigencast.js, view.js, element.js, publisher.js
// and worker.js; the page: page.html, page.css and page.js; and internals.js for tests. Types are checked by tsc.
// build.mjs --package OUT: the package for npm, into the folder with its wasm: the same but the page, its worker in one
// file, so that bundlers may take it elsewhere, adapters, and parts.js and inline.js, which hold worker and wasm.
//
// {web} in page.html stands for the path from the page to the folder of these files, whose path holds /v1/web/: who
// serves the page fills it in.
import { build } from 'esbuild';
import { existsSync, readFileSync, readdirSync, rmSync, writeFileSync } from 'node:fs';
import { basename, join } from 'node:path';
import { fileURLToPath } from 'node:url';
import { nativeShaders } from './shaders.mjs';

const here = (path) => fileURLToPath(new URL(path, import.meta.url));
const isPackage = process.argv[2] === '--package';
const outdir = process.argv[isPackage ? 3 : 2] ?? here('dist');
const worker = { worker: here('src/worker/index.ts') };

/** `inline:NAME`: the wasm of OUT in base64, or the worker in one file. */
const inlined = {
  name: 'inlined',
  setup(plugin) {
    plugin.onResolve({ filter: /^inline:/ }, ({ path }) => ({ path: path.slice('inline:'.length), namespace: 'inline' }));
    plugin.onLoad({ filter: /\.wasm$/, namespace: 'inline' }, ({ path }) => ({ contents: readFileSync(join(outdir, path)), loader: 'base64' }));
    plugin.onLoad({ filter: /^worker\.js$/, namespace: 'inline' }, async () => ({ contents: (await build({ ...options, entryPoints: worker, write: false })).outputFiles[0].text, loader: 'text' }));
  },
};
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
for (const old of existsSync(outdir) ? readdirSync(outdir) : []) if (/^eigencast-\w{8}\.js$/.test(old)) rmSync(join(outdir, old));
// What page and worker share is loaded once, and so is what the entries of the package share.
const split = { ...options, splitting: true, chunkNames: 'eigencast-[hash]', metafile: true };
const entriesOf = (...names) => Object.fromEntries(names.map((name) => [name, here(`src/${name}/index.ts`)]));
const entries = { eigencast: here('src/client/index.ts'), ...entriesOf('view', 'element', 'publisher', ...(isPackage ? ['three', 'react', 'babylon', 'parts'] : [])) };
await build({ ...split, entryPoints: entries });
if (isPackage) {
  await build({ ...options, entryPoints: { ...worker, ...entriesOf('inline') } });
} else {
  const { metafile } = await build({ ...split, entryPoints: { page: here('src/page/page.ts'), ...worker } });
  await build({ ...options, entryPoints: { internals: here('src/internals.ts') } });
  await build({ ...options, entryPoints: { page: here('src/page/page.css') } });
  // The worker takes what the page has fetched, too.
  const loaded = Object.entries(metafile.outputs).filter(([, { entryPoint }]) => /src\/(page\/page|worker\/index)\.ts$/.test(entryPoint));
  const files = new Set(loaded.flatMap(([path, { imports }]) => [path, ...imports.filter(({ kind }) => kind === 'import-statement').map((one) => one.path)]).map((path) => basename(path)));
  const chunks = [...files].filter((file) => file !== 'page.js').map((file) => `<link rel="modulepreload" href="{web}${file}">`);
  const page = readFileSync(here('src/page/index.html'), 'utf8').replace('<!-- {preload} -->', chunks.join('\n'));
  writeFileSync(join(outdir, 'page.html'), page.replace(/\n+/g, '\n'));
}
