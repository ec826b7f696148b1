// SPDX-License-Identifier: MIT
//
// serve.mjs PORT: the page for the broker at PORT of this machine, until it is ended; says where. For development.
import { startSite } from './site.mjs';

console.log((await startSite(Number(process.argv[2]))).url);
