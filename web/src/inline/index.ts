// SPDX-License-Identifier: MIT
/** `eigencast/inline`: client, view and <eigencast-view> in one file, WebAssembly and worker inside: for CDNs and notebooks. */
import '../parts/index.js';
export * from '../client/index.js';
export * from '../element/index.js';
export * from '../view/index.js';
