// SPDX-License-Identifier: MIT
/** `eigencast`: watches live, deforming surfaces. */
export { Broker, connect, Stream, watch } from './client.js';
export type { ConnectOptions, ListedStream, StreamEvents, WatchOptions } from './client.js';
export type { ClockEstimate } from './clock_offset.js';
export type { StreamInfo } from './control.js';
export type { Environment } from './environment.js';
export type { Profile } from './profile.js';
export type { Rebuild, Rebuilt } from './protocol.js';
export type { Pose, State, Status, Surface } from './subscription.js';
export { Core, EigencastError } from '../core/module.js';
export { Playout, type PlayoutMode, type PlayoutSettings, type Shown, type ShownPose } from '../core/playout.js';
export { Levels, type LevelObject } from '../core/levels.js';
export type { AssetFacts } from '../core/asset.js';
export type { Counts, Format, Scheme } from '../core/frames.js';
