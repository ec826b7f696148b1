// SPDX-License-Identifier: MIT
/**
 * `eigencast/parts`: importing it puts WebAssembly and worker inside, so that nothing else is loaded: for bundlers that
 * copy no files. A page's policy needs `script-src 'wasm-unsafe-eval'` and `worker-src blob:`.
 */
import core from 'inline:eigencast-core.wasm';
import levels from 'inline:eigencast-levels.wasm';
import worker from 'inline:worker.js';
import { defaults } from '../client/defaults.js';
import { inflated } from '../core/base64.js';

defaults.core = inflated(core);
defaults.levels = inflated(levels);
defaults.worker = URL.createObjectURL(new Blob([worker], { type: 'text/javascript' }));
