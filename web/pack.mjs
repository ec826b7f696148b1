// SPDX-License-Identifier: MIT
//
// pack.mjs WASM_FOLDER OUT: makes OUT/eigencast-VERSION.tgz, the package for npm; WASM_FOLDER holds what web/core makes.
import { spawnSync } from 'node:child_process';
import { copyFileSync, mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join, resolve } from 'node:path';
import { fileURLToPath } from 'node:url';

const here = (path) => fileURLToPath(new URL(path, import.meta.url));
const [wasm, out] = process.argv.slice(2).map((path) => resolve(path));
const stage = mkdtempSync(join(tmpdir(), 'eigencast-package-')), dist = join(stage, 'dist');
const COLUMNS = 'eigencast-columns.wasm';
const run = (program, ...words) => {
  const { status } = spawnSync(program, words, { cwd: stage, stdio: ['ignore', 'inherit', 'inherit'] });
  if (status !== 0) throw new Error(`${program} ${words[0]} failed`);
};
try {
  mkdirSync(dist);
  mkdirSync(out, { recursive: true });
  const { devDependencies, scripts, ...manifest } = JSON.parse(readFileSync(here('package.json'), 'utf8'));
  writeFileSync(join(stage, 'package.json'), `${JSON.stringify(manifest, null, 2)}\n`);
  for (const file of ['README.md', '../LICENSE']) copyFileSync(here(file), join(stage, file.replace('../', '')));
  for (const module of ['eigencast-core.wasm', 'eigencast-levels.wasm', 'eigencast-writer.wasm', COLUMNS]) copyFileSync(join(wasm, module), join(dist, module));
  run(process.execPath, here('build.mjs'), '--package', dist);
  rmSync(join(dist, COLUMNS));  // Inside the scripts.
  run(process.execPath, here('node_modules/typescript/bin/tsc'), '-p', here('tsconfig.json'), '--outDir', join(dist, 'types'));
  run('npm', 'pack', '--silent', '--ignore-scripts', '--pack-destination', out);
} finally {
  rmSync(stage, { recursive: true, force: true });
}
