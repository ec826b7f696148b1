// SPDX-License-Identifier: MIT
import type { AssetReader } from '../core/asset.js';
import { hexFrom } from '../core/module.js';
import type { Arriving } from './surface_source.js';

/** Columns that a stream has learnt, to `whole`, made of the manifest of what arrives: where `after` has its chunks, with all of them. */
export async function addColumns(arriving: Arriving, whole: AssetReader, after: Arriving | undefined): Promise<void> {
  const { core } = whole, at = core.exports.asset_columns(whole.at);
  if (at === 0) return;
  const id = hexFrom(core.bytes(at, 32)), [maxBytes = 0] = core.words(at + 32, 1);
  arriving.totalBytes += maxBytes;
  const section = await arriving.fetcher.get({ id, maxBytes }, (bytes) => core.sha256(bytes) === id);
  if (!section || arriving.fetcher.isStopped) return;
  whole.addColumns(section, after?.isFinished ? after.reader : undefined);
  arriving.checkFormat(whole.facts.rank);
  if (whole.isComplete && after) [arriving.look, arriving.totalBytes] = [after.look, after.totalBytes + maxBytes];
}
