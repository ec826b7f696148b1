// SPDX-License-Identifier: MIT

/** Linear light of sRGB parts. */
export function linearFrom(colours: Uint8Array): Float32Array {
  return Float32Array.from(colours, (part) => LINEAR[part]!);
}
const LINEAR = Float32Array.from({ length: 256 }, (_, i) => {
  const part = i / 255;
  return part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4;
});

export const blobOf = (image: Uint8Array): Blob => new Blob([image as BufferSource], { type: image[0] === 0x89 ? 'image/png' : 'image/jpeg' });

/** A PNG or JPEG as it is; nothing: it cannot be decoded. */
export function imageOf(image: Uint8Array): Promise<ImageBitmap | undefined> {
  return createImageBitmap(blobOf(image), { colorSpaceConversion: 'none', premultiplyAlpha: 'none' }).catch(() => undefined);
}
