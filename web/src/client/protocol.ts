// SPDX-License-Identifier: MIT
import type { Request } from './connection.js';
import type { StreamInfo } from './control.js';
import type { Profile } from './profile.js';
import type { Pose, Status, Surface } from './subscription.js';
import type { Limits } from './surface_source.js';
import type { BrokerUrl } from './url.js';

// What the page and the worker that serves it send each other. `key` names a stream of the page.

export interface Rebuild {
  coefficients: Float64Array;
  channels: number;
  /** Vertices; clamped to what there is. */
  level?: number;
  /** Rows of the coefficients that count; 0: all. */
  rank?: number;
  /** Numbers for the vertices, from coefficients of rank x 3: the length of each vertex's vector, or its first entry. */
  numbers?: { coefficients: Float64Array; isLength: boolean } | undefined;
  /** With UVs, where the surface has an image. */
  isTextured?: boolean;
  /** Vertices by their numbers in the source, whose places come with the answer. */
  points?: Uint32Array | undefined;
  /** Of the screen: vertices of a mesh come and go at a pace; nothing: at once. */
  pxPerUnit?: number;
  /** Taken for the result where they are large enough: what comes back goes round. */
  room?: { positions?: ArrayBuffer; normals?: ArrayBuffer };
  /** Of the triangles that the page has; others come with the answer. */
  trianglesVersion?: number;
}
export interface Rebuilt {
  epoch: number;
  vertices: number;
  /** The surface's own vertices; where its image has seams more are drawn. */
  level: number;
  /** Between levels: the same pose will look otherwise. */
  isMoving: boolean;
  positions: Float32Array;
  /** Of the positions: three lowest, three highest. */
  box: number[];
  normals: Float32Array | undefined;
  /** Those of a cloud's discs; as with triangles, nothing where the page has them. */
  radii: Float32Array | undefined;
  /** Likewise: two a vertex, below -1e30 outside the image; nothing: not textured. */
  uvs: Float32Array | undefined;
  /** With UVs: which of the surface's vertices each one is. */
  origins: Uint32Array | undefined;
  /** Nothing: those of the version that the page has. */
  triangles: Uint32Array | undefined;
  trianglesVersion: number;
  /** As they were asked for, one for each of `level` vertices, and the range of most of them. */
  numbers: Float32Array | undefined;
  range: readonly [low: number, high: number] | undefined;
  /** Three for each that was asked for, whatever the level; NaN: it has not arrived. */
  points: Float32Array | undefined;
  /** Milliseconds that it took. */
  tookMs: number;
}

export type ToWorker =
  | { op: 'begin'; broker: BrokerUrl }
  | { op: 'core'; module: WebAssembly.Module }
  | ({ op: 'watch'; key: number } & Request & Limits)
  | { op: 'profile'; key: number; profile: Profile }
  | { op: 'pause'; key: number; isPaused: boolean }
  | { op: 'leave'; key: number }
  | { op: 'rebuild'; key: number; request: number; rebuild: Rebuild }
  /** The numbers in the source of some of its drawn vertices. */
  | { op: 'sources'; key: number; request: number; vertices: Uint32Array; isTextured: boolean }
  /** A control message of rooms or groups, lost where there is no connection. */
  | { op: 'room'; text: string }
  | { op: 'retry' }
  | { op: 'end' };

export type ToPage =
  | { op: 'status'; key: number; status: Status }
  | { op: 'info'; key: number; info: StreamInfo }
  | { op: 'surface'; key: number; surface: Surface }
  | { op: 'image'; key: number; image: Uint8Array }
  | { op: 'pose'; key: number; pose: Pose }
  | { op: 'rebuilt'; key: number; request: number; rebuilt: Rebuilt }
  | { op: 'sources'; key: number; request: number; sources: Uint32Array }
  /** Of rooms, or a moment; nothing: there is a new connection. */
  | { op: 'room'; key: 0; text: string }
  | { op: 'failed'; key: number; request?: number; code: string; message: string };
