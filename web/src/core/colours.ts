// SPDX-License-Identifier: MIT

const LINEAR = Float32Array.from({ length: 256 }, (_, i) => {
  const part = i / 255;
  return part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4;
});

/** Linear light of sRGB parts, three a row; of the rows that `origins` names, one after the other. */
export function linearFrom(colours: Uint8Array, origins?: Uint32Array): Float32Array {
  if (!origins) return Float32Array.from(colours, (part) => LINEAR[part]!);
  return Float32Array.from({ length: 3 * origins.length }, (_, i) => LINEAR[colours[3 * origins[Math.floor(i / 3)]! + (i % 3)]!]!);
}
