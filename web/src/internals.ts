// SPDX-License-Identifier: MIT
// What tests in Node look into; not part of the package.
export * from './core/module.js';
export * from './core/frames.js';
export * from './core/playout.js';
export * from './core/asset.js';
export { Surface } from './core/surface.js';
export * from './core/levels.js';
export { Writer } from './core/writer.js';
export * from './client/index.js';
export { profileIn } from './client/client.js';
export { publish, Publisher } from './publisher/index.js';
export { readControl, writeControl } from './client/control.js';
export { ClockOffset } from './client/clock_offset.js';
export { Retry, retryDelay, tryAgainIn } from './client/retry.js';
export { brokerUrl, streamUrl } from './client/url.js';
export { BrokerConnection } from './client/connection.js';
export { ObjectFetcher } from './client/objects.js';
export { Camera } from './view/camera.js';
export { NumberPainter, roundUp, tableOf } from './view/numbers.js';
export { pick } from './view/pick.js';
export { crc32c, RecordingReader, sourceOf, TYPES } from './recording/reader.js';
export { RecordedSession } from './recording/session.js';
export { Player } from './recording/player.js';
export { textFromUs } from './recording/bar.js';
export { tileWidth } from './page/list_page.js';
export { linkOf, pageOf, placeOf } from './page/place.js';
export { bannerOf } from './page/words.js';
export { figureLines, textFromMode } from './page/figures.js';
