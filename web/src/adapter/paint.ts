// SPDX-License-Identifier: MIT

export const blobOf = (image: Uint8Array): Blob => new Blob([image as BufferSource], { type: image[0] === 0x89 ? 'image/png' : 'image/jpeg' });

/** A PNG or JPEG as it is; nothing: it cannot be decoded. */
export function imageOf(image: Uint8Array): Promise<ImageBitmap | undefined> {
  return createImageBitmap(blobOf(image), { colorSpaceConversion: 'none', premultiplyAlpha: 'none' }).catch(() => undefined);
}
