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

/** How far along a ray a triangle is hit, and where in it. */
type Along = readonly [t: number, u: number, v: number];
const NOWHERE: Along = [Infinity, 0, 0];

/** Möller, Trumbore 1997, "Fast, minimum storage ray-triangle intersection"; both sides count. */
function hitTriangle(from: Vec3, along: Vec3, a: Vec3, b: Vec3, c: Vec3): Along {
  const ab = difference(b, a), ac = difference(c, a), p = cross(along, ac), determinant = dot(ab, p);
  const s = difference(from, a), q = cross(s, ab);
  const u = dot(s, p) / determinant, v = dot(along, q) / determinant;
  return u >= 0 && v >= 0 && u + v <= 1 ? [dot(ac, q) / determinant, u, v] : NOWHERE;
}

export interface Hit {
  at: Vec3;
  /** Of the triangle; of a point three times the same. */
  vertices: [number, number, number];
  /** Barycentric. */
  weights: Vec3;
}

/** The nearest point under a pixel of the camera's canvas, scene units. */
export function pick(surfaces: readonly Pickable[], camera: Camera, pixel: Pixel): Hit | undefined {
  const from = camera.position, along = camera.directionThrough(pixel);
  let nearest = Infinity, hit: Hit | undefined;
  const take = ([t, u, v]: Along, a: number, b: number, c: number): void => {
    if (!(t > 0 && t < nearest)) return;
    nearest = t;
    hit = { at: sum(from, times(t, along)), vertices: [a, b, c], weights: [1 - u - v, u, v] };
  };
  for (const { positions, triangles, sceneFromSurface, radius } of surfaces) {
    const points = Array.from({ length: positions.length / 3 }, (_, i): Vec3 =>
      moved(sceneFromSurface, [positions[3 * i]!, positions[3 * i + 1]!, positions[3 * i + 2]!]));
    for (let i = 0; i < triangles.length; i += 3) {
      const a = triangles[i]!, b = triangles[i + 1]!, c = triangles[i + 2]!;
      take(hitTriangle(from, along, points[a]!, points[b]!, points[c]!), a, b, c);
    }
    if (triangles.length > 0) continue;
    points.forEach((point, i) => {
      const t = dot(difference(point, from), along);
      if (length(difference(sum(from, times(t, along)), point)) <= radius) take([t, 0, 0], i, i, i);
    });
  }
  return hit;
}
