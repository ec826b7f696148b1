// SPDX-License-Identifier: MIT
//
// build.mjs [OUT]: bundles into OUT (default: dist) the package, eigencast.js, view.js, element.js, publisher.js and worker.js; the page, page.html, page.css
// and page.js; and internals.js for tests. Types are checked by tsc (npm run types).
//
// {web} in page.html stands for the path from the page to the folder of these files, whose path holds /v1/web/: who
// serves the page fills it in.
import { build } from 'esbuild';
import { existsSync, readFileSync, readdirSync, rmSync, writeFileSync } from 'node:fs';
import { basename, join } from 'node:path';
import { fileURLToPath } from 'node:url';
import { nativeShaders } from './shaders.mjs';

const here = (path) => fileURLToPath(new URL(path, import.meta.url));
const options = {
  outdir: process.argv[2] ?? here('dist'),
  bundle: true,
  minify: true,
  format: 'esm',
  target: 'es2022',
  legalComments: 'inline',
  logLevel: 'warning',
  plugins: [nativeShaders],
};
const { outdir } = options;
for (const old of existsSync(outdir) ? readdirSync(outdir) : []) if (/^eigencast-\w{8}\.js$/.test(old)) rmSync(join(outdir, old));
// What page and worker share is loaded once, and so is what the entries of the package share.
const split = { ...options, splitting: true, chunkNames: 'eigencast-[hash]', metafile: true };
const { metafile } = await build({ ...split, entryPoints: { page: here('src/page/page.ts'), worker: here('src/worker/index.ts') } });
await build({ ...split, entryPoints: { eigencast: here('src/client/index.ts'), view: here('src/view/index.ts'), element: here('src/element/index.ts'), publisher: here('src/publisher/index.ts') } });
await build({ ...options, entryPoints: { internals: here('src/internals.ts') } });
await build({ ...options, entryPoints: { page: here('src/page/page.css') } });

const entry = Object.values(metafile.outputs).find((one) => one.entryPoint?.endsWith('src/page/page.ts'));
const chunks = entry.imports.filter(({ kind }) => kind === 'import-statement').map(({ path }) => `<link rel="modulepreload" href="{web}${basename(path)}">`);
const page = readFileSync(here('src/page/index.html'), 'utf8').replace('<!-- {preload} -->', chunks.join('\n'));
writeFileSync(join(outdir, 'page.html'), page.replace(/\n+/g, '\n'));
