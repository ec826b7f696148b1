// SPDX-License-Identifier: MIT
import type { Camera, Pixel } from './camera.js';
import { cross, difference, dot, length, moved, sum, times, type Mat4, type Vec3 } from './matrix.js';

export interface Pickable {
  /** Three a vertex, surface units. */
  positions: Float32Array;
  /** Three indices a triangle; none: points. */
  triangles: Uint32Array;
  sceneFromSurface: Mat4;
  /** Of a point, scene units. */
  radius: number;
}

/** Möller, Trumbore 1997, "Fast, minimum storage ray-triangle intersection"; both sides count. */
function hitTriangle(from: Vec3, along: Vec3, a: Vec3, b: Vec3, c: Vec3): number {
  const ab = difference(b, a), ac = difference(c, a), p = cross(along, ac), determinant = dot(ab, p);
  const s = difference(from, a), q = cross(s, ab);
  const u = dot(s, p) / determinant, v = dot(along, q) / determinant;
  return u >= 0 && v >= 0 && u + v <= 1 ? dot(ac, q) / determinant : Infinity;
}

/** The nearest point under a pixel. */
export function pick(surfaces: readonly Pickable[], camera: Camera, pixel: Pixel): Vec3 | undefined {
  const from = camera.position, along = camera.directionThrough(pixel);
  let nearest = Infinity;
  const take = (t: number): void => {
    if (t > 0 && t < nearest) nearest = t;
  };
  for (const { positions, triangles, sceneFromSurface, radius } of surfaces) {
    const points = Array.from({ length: positions.length / 3 }, (_, i): Vec3 =>
      moved(sceneFromSurface, [positions[3 * i]!, positions[3 * i + 1]!, positions[3 * i + 2]!]));
    for (let i = 0; i < triangles.length; i += 3) {
      take(hitTriangle(from, along, points[triangles[i]!]!, points[triangles[i + 1]!]!, points[triangles[i + 2]!]!));
    }
    if (triangles.length > 0) continue;
    for (const point of points) {
      const t = dot(difference(point, from), along);
      if (length(difference(sum(from, times(t, along)), point)) <= radius) take(t);
    }
  }
  return nearest < Infinity ? sum(from, times(nearest, along)) : undefined;
}
