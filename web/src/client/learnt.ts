// SPDX-License-Identifier: MIT
import type { AssetReader } from '../core/asset.js';
import type { Arriving } from './surface_source.js';

/**
 * Where a surface that arrives has all chunks of the one that is shown, and nothing new but columns that its stream has
 * learnt, it takes these over: nothing is fetched again. `whole`: made of its manifest; then freed.
 */
export function takeOver(arriving: Arriving, after: Arriving, whole: AssetReader): boolean {
  const { chunkCount } = whole;
  if (!after.isFinished || after.reader!.chunkCount !== chunkCount) return false;
  const facts = (reader: AssetReader): string => JSON.stringify({ ...reader.facts, rowsReady: 0, facesReady: 0, hasDetail: false, hasSplats: false, rest: Array.from(reader.rest) });
  if (facts(whole) !== facts(after.reader!)) return false;
  for (let i = 0; i < chunkCount; ++i) if (whole.chunk(i).id !== after.reader!.chunk(i).id) return false;
  whole.free();
  [arriving.reader, after.reader] = [after.reader, undefined];
  arriving.look = after.look;
  arriving.checkFormat(arriving.reader!.facts.rank);
  return true;
}
