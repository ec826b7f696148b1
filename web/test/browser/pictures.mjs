// SPDX-License-Identifier: MIT
import { deflateSync, inflateSync } from 'node:zlib';

/** Of an 8-bit PNG without interlacing: {width, height, rgb: 3 bytes a pixel}. */
export function readPng(png) {
  const parts = [];
  let width = 0, height = 0, channels = 0;
  for (let at = 8; at < png.length;) {
    const size = png.readUInt32BE(at), kind = png.toString('latin1', at + 4, at + 8), data = png.subarray(at + 8, at + 8 + size);
    if (kind === 'IHDR') [width, height, channels] = [data.readUInt32BE(0), data.readUInt32BE(4), { 2: 3, 6: 4 }[data[9]]];
    if (kind === 'IDAT') parts.push(data);
    at += 12 + size;
  }
  const raw = inflateSync(Buffer.concat(parts)), stride = channels * width, lines = new Uint8Array(stride * height);
  for (let y = 0; y < height; ++y) {
    const filter = raw[y * (stride + 1)];
    for (let x = 0; x < stride; ++x) {
      const at = y * stride + x;
      const left = x < channels ? 0 : lines[at - channels], above = y === 0 ? 0 : lines[at - stride], corner = x < channels || y === 0 ? 0 : lines[at - stride - channels];
      const guess = left + above - corner, near = [Math.abs(guess - left), Math.abs(guess - above), Math.abs(guess - corner)];
      const paeth = near[0] <= near[1] && near[0] <= near[2] ? left : near[1] <= near[2] ? above : corner;
      lines[at] = raw[y * (stride + 1) + 1 + x] + [0, left, above, (left + above) >> 1, paeth][filter];
    }
  }
  const rgb = new Uint8Array(3 * width * height);
  for (let i = 0; i < width * height; ++i) rgb.set(lines.subarray(channels * i, channels * i + 3), 3 * i);
  return { width, height, rgb };
}

const crc32 = (bytes) => {
  let crc = ~0;
  for (const byte of bytes) {
    crc ^= byte;
    for (let k = 0; k < 8; ++k) crc = (crc >>> 1) ^ (crc & 1 ? 0xedb88320 : 0);
  }
  return ~crc >>> 0;
};
/** rgb: of a pixel, from its column and line. */
export function makePng(width, height, rgb) {
  const part = (kind, data) => {
    const body = Buffer.concat([Buffer.from(kind, 'latin1'), data]), size = Buffer.alloc(4), sum = Buffer.alloc(4);
    size.writeUInt32BE(data.length);
    sum.writeUInt32BE(crc32(body));
    return Buffer.concat([size, body, sum]);
  };
  const head = Buffer.alloc(13);
  head.writeUInt32BE(width);
  head.writeUInt32BE(height, 4);
  head.set([8, 2], 8);
  const lines = Array.from({ length: height }, (_, y) => [0, ...Array.from({ length: width }, (_, x) => rgb(x, y)).flat()]);
  const signature = Buffer.from('89504e470d0a1a0a', 'hex');
  return Buffer.concat([signature, part('IHDR', head), part('IDAT', deflateSync(Buffer.from(lines.flat()))), part('IEND', Buffer.alloc(0))]);
}

const grey = ({ rgb }, i) => 0.299 * rgb[3 * i] + 0.587 * rgb[3 * i + 1] + 0.114 * rgb[3 * i + 2];

/** Structural similarity of two pictures of one size, windows of 8 x 8: its mean, and that of its worst hundredth. */
export function similarity(a, b) {
  if (a.width !== b.width || a.height !== b.height) throw new Error(`${a.width} x ${a.height} against ${b.width} x ${b.height}`);
  const values = [];
  for (let y = 0; y + 8 <= a.height; y += 4) {
    for (let x = 0; x + 8 <= a.width; x += 4) {
      let sa = 0, sb = 0, aa = 0, bb = 0, ab = 0;
      for (let i = 0; i < 64; ++i) {
        const at = (y + (i >> 3)) * a.width + x + (i & 7), p = grey(a, at), q = grey(b, at);
        sa += p; sb += q; aa += p * p; bb += q * q; ab += p * q;
      }
      const ma = sa / 64, mb = sb / 64, va = aa / 64 - ma * ma, vb = bb / 64 - mb * mb, cov = ab / 64 - ma * mb;
      values.push(((2 * ma * mb + 6.5025) * (2 * cov + 58.5225)) / ((ma * ma + mb * mb + 6.5025) * (va + vb + 58.5225)));
    }
  }
  values.sort((p, q) => p - q);
  const mean = (some) => some.reduce((sum, value) => sum + value, 0) / some.length;
  return { mean: mean(values), worst: mean(values.slice(0, Math.ceil(values.length / 100))) };
}

/** Mean difference of channels, of 255. */
export function difference(a, b) {
  let sum = 0;
  a.rgb.forEach((value, i) => (sum += Math.abs(value - b.rgb[i])));
  return sum / a.rgb.length;
}
