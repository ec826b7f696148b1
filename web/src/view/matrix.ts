// SPDX-License-Identifier: MIT

export type Vec3 = readonly [number, number, number];
/** By columns, as OpenGL has it. */
export type Mat4 = readonly number[];

export const IDENTITY: Mat4 = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

export const sum = (a: Vec3, b: Vec3): Vec3 => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const times = (s: number, a: Vec3): Vec3 => [s * a[0], s * a[1], s * a[2]];
export const difference = (a: Vec3, b: Vec3): Vec3 => sum(a, times(-1, b));
export const dot = (a: Vec3, b: Vec3): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a: Vec3, b: Vec3): Vec3 =>
  [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const length = (a: Vec3): number => Math.hypot(...a);
export const unit = (a: Vec3): Vec3 => times(1 / length(a), a);

export function product(a: Mat4, b: Mat4): Mat4 {
  return b.map((_, i) => {
    const row = i & 3, column = i & ~3;
    let total = 0;
    for (let k = 0; k < 4; ++k) total += a[row + 4 * k]! * b[column + k]!;
    return total;
  });
}

/** Of an affine matrix. */
export function moved(m: Mat4, [x, y, z]: Vec3): Vec3 {
  const row = (i: number): number => m[i]! * x + m[i + 4]! * y + m[i + 8]! * z + m[i + 12]!;
  return [row(0), row(1), row(2)];
}

export function lookAt(eye: Vec3, target: Vec3, up: Vec3): Mat4 {
  const back = unit(difference(eye, target)), right = unit(cross(up, back)), above = cross(back, right);
  return [
    right[0], above[0], back[0], 0, right[1], above[1], back[1], 0, right[2], above[2], back[2], 0,
    -dot(right, eye), -dot(above, eye), -dot(back, eye), 1,
  ];
}

/** fieldOfView: vertical, radians. */
export function perspective(fieldOfView: number, aspect: number, near: number, far: number): Mat4 {
  const f = 1 / Math.tan(fieldOfView / 2);
  return [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, (2 * far * near) / (near - far), 0];
}

/** A box of `reach` to all sides, `deep` from its front. */
export function orthographic(reach: number, deep: number): Mat4 {
  return [1 / reach, 0, 0, 0, 0, 1 / reach, 0, 0, 0, 0, -2 / deep, 0, 0, 0, -1, 1];
}

/** What normals are multiplied with, 3 x 3: right for mirrors, shears and flattening, too. */
export function normalMatrix(m: Mat4): number[] {
  const column = (i: number): Vec3 => [m[4 * i]!, m[4 * i + 1]!, m[4 * i + 2]!];
  const sign = determinant(m) < 0 ? -1 : 1;
  return [[1, 2], [2, 0], [0, 1]].flatMap(([i, k]) => times(sign, cross(column(i!), column(k!))));
}

/** Of the linear part. */
export function determinant(m: Mat4): number {
  return dot([m[0]!, m[1]!, m[2]!], cross([m[4]!, m[5]!, m[6]!], [m[8]!, m[9]!, m[10]!]));
}
