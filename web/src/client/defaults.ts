// SPDX-License-Identifier: MIT
import type { ConnectOptions } from './client.js';

type Module = NonNullable<ConnectOptions['core']> | Promise<BufferSource>;

/** What the package loads besides its scripts, from beside them; eigencast/parts puts it inside. */
export const defaults: { core: Module; writer: Module; levels: Module; worker: URL | string } = {
  core: new URL('./eigencast-core.wasm', import.meta.url), writer: new URL('./eigencast-writer.wasm', import.meta.url),
  levels: new URL('./eigencast-levels.wasm', import.meta.url), worker: new URL('./worker.js', import.meta.url),
};
