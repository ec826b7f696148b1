// SPDX-License-Identifier: MIT

export function bytesFromBase64(text: string): Uint8Array<ArrayBuffer> {
  return Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
}
/** What the build has put inside: deflated, in base64. */
export function inflated(text: string): Promise<ArrayBuffer> {
  return new Response(new Blob([bytesFromBase64(text)]).stream().pipeThrough(new DecompressionStream('deflate'))).arrayBuffer();
}
