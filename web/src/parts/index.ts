// SPDX-License-Identifier: MIT
/**
 * `eigencast/parts`: importing it puts WebAssembly and worker inside, so that nothing else is loaded: for bundlers that
 * copy no files. A page's policy needs `script-src 'wasm-unsafe-eval'` and `worker-src blob:`.
 */
import core from 'inline:eigencast-core.wasm';
import worker from 'inline:worker.js';
import { defaults } from '../client/defaults.js';

defaults.core = Uint8Array.from(atob(core), (character) => character.charCodeAt(0));
defaults.worker = URL.createObjectURL(new Blob([worker], { type: 'text/javascript' }));
