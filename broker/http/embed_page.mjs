// SPDX-License-Identifier: MIT
// Packs the page that web/ built into OUT.bin, and its table for web_page.h into OUT.cpp: embed_page.mjs FOLDER OUT
import { createHash } from 'node:crypto';
import { readdirSync, readFileSync, writeFileSync } from 'node:fs';
import { brotliCompressSync, constants, gzipSync } from 'node:zlib';

const [folder, out] = process.argv.slice(2);
const there = readdirSync(folder, { withFileTypes: true }).filter((entry) => entry.isFile()).map((entry) => entry.name).sort();

// What these name, and what that names: earlier builds leave files behind.
const names = ['page.html', 'show.html', 'element.js', 'eigencast.js', 'view.js', 'publisher.js'].filter((name) => there.includes(name));
for (const name of names) {
  if (/\.wasm$/.test(name)) continue;
  const text = readFileSync(`${folder}/${name}`, 'utf8');
  names.push(...there.filter((other) => /\.(js|css|wasm)$/.test(other) && !names.includes(other) && text.includes(other)));
}

const version = createHash('sha256');
let size = 0;
const pieces = [];
const kept = (bytes, most) => {
  if (bytes.length >= most) return '{}';
  pieces.push(bytes);
  size += bytes.length;
  return `{eigencast_web_bytes + ${size - bytes.length}, ${bytes.length}}`;
};
const rows = names.map((name) => {
  const plain = readFileSync(`${folder}/${name}`);
  version.update(`${name} ${plain.length}\n`).update(plain);
  if (name === 'page.html') return `{"${name}", ${kept(plain, Infinity)}, {}, {}}`;
  const brotli = brotliCompressSync(plain, { params: { [constants.BROTLI_PARAM_SIZE_HINT]: plain.length } });
  return `{"${name}", ${kept(plain, Infinity)}, ${kept(gzipSync(plain, { level: 9 }), plain.length)}, ${kept(brotli, plain.length)}}`;
});

writeFileSync(`${out}.bin`, Buffer.concat(pieces));
writeFileSync(`${out}.cpp`, `#include "broker/http/web_page.h"

__asm__(
    ".section .rodata\\n.global eigencast_web_bytes\\n.hidden eigencast_web_bytes\\neigencast_web_bytes:\\n"
    ".incbin \\"${out}.bin\\"\\n.byte 0\\n.previous\\n");
extern "C" __attribute__((visibility("hidden"))) const char eigencast_web_bytes[];

namespace eigencast::broker {

std::span<const WebFile> web_files() {
  static const WebFile kFiles[] = {
      ${rows.join(',\n      ')}};
  return kFiles;
}
std::string_view web_version() {
  return "${version.digest('hex').slice(0, 16)}";
}

}  // namespace eigencast::broker
`);
