// SPDX-License-Identifier: MIT
import type { AssetReader } from './asset.js';
import type { Core } from './module.js';

/** Views, of use until the next call of the core. */
export interface Geometry {
  /** Three a vertex. */
  positions: Float32Array;
  /** Three a vertex; nothing: a cloud without discs. */
  normals: Float32Array | undefined;
  /** Of a cloud's discs. */
  radii: Float32Array | undefined;
  /** Three indices a triangle. */
  triangles: Uint32Array;
  /** Two a vertex, of the surface's image; below -1e30: outside. Nothing: not textured. */
  uvs: Float32Array | undefined;
  /** With UVs: which of the surface's vertices each one is. */
  origins: Uint32Array | undefined;
  vertices: number;
  /** The surface's own vertices; where its image has seams more are drawn. */
  level: number;
  /** Between levels: the same pose will look otherwise. */
  isMoving: boolean;
  /** Grows when triangles, radii or uvs change. */
  trianglesVersion: number;
}

/** Numbers of vertices, as colours show them. */
export interface Numbers {
  /** A view, of use until the next call of the core. */
  values: Float32Array;
  /** Of the finite ones without the outermost hundredths; nothing: none is finite. */
  range: readonly [low: number, high: number] | undefined;
}

/** Rebuilds poses of one asset at a level of detail. Call free() when done. */
export class Surface {
  readonly #core: Core;
  readonly #at: number;
  #level = 0;

  constructor(core: Core) {
    this.#core = core;
    this.#at = core.exports.surface_make();
  }
  free(): void {
    this.#core.exports.surface_free(this.#at);
  }

  /** Takes what has arrived of the asset since the last time; another asset starts anew. */
  update(asset: AssetReader): void {
    this.#core.checked(this.#core.exports.surface_update(this.#at, asset.at));
  }
  /** coefficients: rank x channels. level: vertices, clamped to what there is. rank: rows that count; 0: all. pxPerUnit, nowUs: core.h. */
  rebuild(asset: AssetReader, coefficients: ArrayLike<number>, channels: number, level = Infinity, rank = 0, isTextured = false, pxPerUnit = 0, nowUs = 0): Geometry {
    const core = this.#core;
    const given = core.givenDoubles(coefficients);
    const at = core.found(core.exports.surface_rebuild(
      this.#at, asset.at, given, coefficients.length, channels, rank, Math.min(level, 0xffffffff), isTextured ? 1 : 0, pxPerUnit, BigInt(Math.round(nowUs))));
    const [positions = 0, normals = 0, radii = 0, triangles = 0, vertices = 0, indices = 0, version = 0, drawnLevel = 0, uvs = 0, origins = 0, isMoving = 0] =
      core.words(at, 11);
    this.#level = drawnLevel;
    return {
      positions: core.floats(positions, 3 * vertices),
      normals: normals === 0 ? undefined : core.floats(normals, 3 * vertices),
      radii: radii === 0 ? undefined : core.floats(radii, vertices),
      triangles: indices === 0 ? new Uint32Array() : core.words(triangles, indices),
      uvs: uvs === 0 ? undefined : core.floats(uvs, 2 * vertices),
      origins: origins === 0 ? undefined : core.words(origins, vertices),
      vertices,
      level: drawnLevel,
      isMoving: isMoving !== 0,
      trianglesVersion: version,
    };
  }
  /** Where vertices are, by their numbers in the source: three each, a view; NaN: what has not arrived. */
  points(asset: AssetReader, coefficients: ArrayLike<number>, channels: number, vertices: Uint32Array): Float32Array {
    const core = this.#core, count = coefficients.length, at = core.room(8 * count + 4 * vertices.length);
    core.doubles(at, count).set(coefficients);
    core.words(at + 8 * count, vertices.length).set(vertices);
    return core.floats(core.found(core.exports.surface_points(this.#at, asset.at, at, count, channels, at + 8 * count, vertices.length)), 3 * vertices.length);
  }
  /** Of the last geometry's `level` vertices, from coefficients of rank x 3: each vertex's length, or its first entry. */
  numbers(asset: AssetReader, coefficients: Float64Array, isLength: boolean): Numbers {
    const core = this.#core, given = core.givenDoubles(coefficients);
    const at = core.found(core.exports.surface_numbers(this.#at, asset.at, given, coefficients.length, isLength ? 1 : 0));
    const [values = 0, , , hasRange = 0] = core.words(at, 4), [, low = 0, high = 0] = core.floats(at, 3);
    return { values: core.floats(values, this.#level), range: hasRange === 0 ? undefined : [low, high] };
  }
}
