// SPDX-License-Identifier: MIT

/** A surface's image, PNG or JPEG, halved until neither side is more than `most`. Nothing: it cannot be decoded. */
export async function decoded(image: Uint8Array, most: number): Promise<ImageBitmap | undefined> {
  const options: ImageBitmapOptions = { colorSpaceConversion: 'none', premultiplyAlpha: 'none' };
  let bitmap = await createImageBitmap(new Blob([image as BufferSource], { type: image[0] === 0x89 ? 'image/png' : 'image/jpeg' }), options).catch(() => undefined);
  while (bitmap && Math.max(bitmap.width, bitmap.height) > most)
    bitmap = await createImageBitmap(bitmap, { ...options, resizeWidth: Math.ceil(bitmap.width / 2), resizeHeight: Math.ceil(bitmap.height / 2) });
  return bitmap;
}
