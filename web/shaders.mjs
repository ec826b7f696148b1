// SPDX-License-Identifier: MIT
//
// For esbuild: view/shaders.h of the native viewer as a module that exports each of its strings as GLSL ES 3.00, so that
// both viewers draw with the same shaders; and the colours of its maps, from view/style.cpp.
import { readFile } from 'node:fs/promises';

const VERSION = '#version 330 core\n';
const PRELUDE = `#version 300 es
precision highp float;precision highp int;precision highp sampler2D;precision highp sampler2DShadow;
`;

/** GLSL 3.30 as GLSL ES 3.00, without comments and blanks. WebGL has no multisampled textures: depth is resolved before. */
export function essl(glsl) {
  const body = glsl
    .replace(VERSION, '')
    .replace(/\/\/.*$/gm, '')
    .replaceAll('sampler2DMS', 'sampler2D')
    .replaceAll('textureSize(depth)', 'textureSize(depth, 0)')
    .replace(/\s+/g, ' ')
    .replace(/ ?([*/=<>!&|,;:?(){}[\]]) ?/g, '$1')
    .trim();
  return glsl.startsWith(VERSION) ? PRELUDE + body : body;
}

export const nativeShaders = {
  name: 'native-shaders',
  setup(build) {
    build.onLoad({ filter: /[/\\]view[/\\]shaders\.h$/ }, async ({ path }) => {
      const source = await readFile(path, 'utf8');
      const found = [...source.matchAll(/inline constexpr const char\* (k\w+) = R"\(([\s\S]*?)\)";/g)];
      return { contents: found.map(([, name, glsl]) => `export const ${name} = ${JSON.stringify(essl(glsl))};`).join('\n') };
    });
    build.onLoad({ filter: /[/\\]view[/\\]style\.cpp$/ }, async ({ path }) => {
      const found = [...(await readFile(path, 'utf8')).matchAll(/constexpr std::array<std::uint32_t, \d+> (k\w+)\{([^}]*)\}/g)];
      return { loader: 'js', contents: found.map(([, name, colours]) => `export const ${name} = [${colours}];`).join('\n') };
    });
  },
};
