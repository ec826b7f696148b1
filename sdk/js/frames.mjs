// SPDX-License-Identifier: MIT
//
// Decodes the binary frames of a stream (docs/protocol.md, sections 4 to 8): bytes in, poses out, no dependency. Bit-exact: integers
// beyond 2^53 are BigInt, all others stay below.

const AHEAD = 1, RESIDUAL = 2, RECALLED = 4;
const SEGMENT_MAGIC = [0x45, 0x43, 0x50, 0x4d, 1];
const MAX_POSES = 1024, MAX_MEMORY_BYTES = 2 ** 23;
const MAX_FRAME_BYTES = 2 ** 20;
const MAX_VALUE = 2 ** 30;
const MAX_TIME = 2n ** 62n - 1n;
const KINDS = [undefined, 'key', 'join', 'step', 'estimate'];
const CODECS = ['float64', 'float32', 'quantised'];
const LONGEST_HERMITE_US = 1_000_000n;
const FOURTH_ROOTS = [1073741824n, 1276901417n, 1518500250n, 1805811301n];
const STEP_ROOTS = [1, 1.189207115002721, 1.4142135623730951, 1.681792830507429];
const EXACT_FOLLOWS = 255;
const SAME_STEP = 3;
const MAX_SCALE = 30;
const NEXT_STATE = [[0, 2], [2, 0], [1, 3], [3, 1]];
const FIRST_OF_CURVE = 59;
const CURVE = [
  97, 158, 238, 339, 460, 600, 936, 1336, 1787, 2277, 2795, 3333, 3881, 4435, 5538, 6616, 7652, 8638, 9570,
  10450, 11277, 12055, 13471, 14724, 15834, 16824, 17709, 18505, 19223, 19875, 21010, 21965, 22778, 23479,
  24089, 24624, 25098, 25520, 26239, 26828, 27320, 27738, 28095, 28406, 28678, 28918, 29322, 29650, 29920,
  30148, 30342, 30509, 30655, 30783, 30997, 31170, 31312, 31431, 31532, 31618, 31694, 31760, 31870, 31959,
  32032, 32092, 32144, 32188, 32226, 32260, 32316, 32361, 32398, 32428, 32454, 32477, 32496, 32513, 32541,
  32564, 32582, 32598, 32611, 32622, 32632, 32640, 32654, 32666, 32675, 32683, 32689, 32695, 32700,
];

/** A frame or a payload that breaks the protocol. */
export class ProtocolError extends Error {}

function require(condition, what) {
  if (!condition) throw new ProtocolError(what);
}

/** The size of a quantiser step: value = q * stepSize(step). */
export function stepSize(index) {
  return STEP_ROOTS[index % 4] * 2 ** Math.floor((index - 160) / 4);
}

class Reader {
  constructor(bytes) {
    this.bytes = bytes;
    this.at = 0;
  }
  take(count) {
    require(count <= this.bytes.length - this.at, 'ends early');
    this.at += count;
    return this.bytes.subarray(this.at - count, this.at);
  }
  /** The next byte, if there is one. */
  peek() {
    return this.bytes[this.at];
  }
  rest() {
    return this.take(this.bytes.length - this.at);
  }
  u8() {
    return this.take(1)[0];
  }
  varint() {
    let value = 0n;
    for (let shift = 0n; ; shift += 7n) {
      const byte = this.u8();
      value |= BigInt(byte & 127) << shift;
      require(value < 2n ** 64n, 'varint over 64 bits');
      if (byte >= 128) continue;
      require(byte !== 0 || shift === 0n, 'superfluous varint byte');
      return value;
    }
  }
  finish() {
    require(this.at === this.bytes.length, 'bytes left over');
  }
}

/** Bits of an exact run, the most significant first. */
class BitReader {
  constructor(bytes) {
    this.bytes = bytes;
    this.at = 0;
  }
  bit() {
    require(this.at < 8 * this.bytes.length, 'bits end early');
    const bit = (this.bytes[this.at >> 3] >> (7 - (this.at & 7))) & 1;
    this.at += 1;
    return bit;
  }
  number(count) {
    let value = 0;
    for (let i = 0; i < count; ++i) value = 2 * value + this.bit();
    return value;
  }
}

class RangeDecoder {
  constructor(bytes) {
    this.bytes = bytes;
    this.next = 0;
    this.range = 0xff000000;
    this.code = 0;
    for (let i = 0; i < 4; ++i) this.shift();
  }
  shift() {
    this.code = ((this.code << 8) | (this.next < this.bytes.length ? this.bytes[this.next] : 0)) >>> 0;
    this.next += 1;
  }
  decision(probability = 16384) {
    const bound = (this.range >>> 15) * probability;
    const taken = this.code < bound;
    if (taken) {
      this.range = bound;
    } else {
      this.code -= bound;
      this.range -= bound;
    }
    while (this.range < 2 ** 24) {
      this.range *= 256;
      this.shift();
    }
    return taken;
  }
  number(count) {
    let value = 0;
    for (let i = 0; i < count; ++i) value = 2 * value + (this.decision() ? 1 : 0);
    return value;
  }
  scale(expected) {
    if (!this.decision(26000)) return expected;
    const less = this.decision();
    let off = 1;
    while (off <= MAX_SCALE && this.decision(19000)) ++off;
    return less ? expected - off : expected + off;
  }
  level(beyond0, beyond1, later) {
    if (!this.decision(beyond0)) return 0;
    if (!this.decision(beyond1)) return 1;
    let level = 2;
    while (level < 24 && this.decision(later)) ++level;
    if (level < 24) return level;
    let bits = 0;
    while (bits < 31 && this.decision()) ++bits;
    let number = 1;
    for (let i = 0; i < bits; ++i) number = 2 * number + (this.decision() ? 1 : 0);
    return level + number - 1;
  }
  finish() {
    const trailing = this.bytes.length > 0 && this.bytes[this.bytes.length - 1] === 0;
    require(this.bytes.length <= this.next && !trailing, 'bytes left over');
  }
}

function more(context) {
  if (context < FIRST_OF_CURVE) return 64;
  return context < FIRST_OF_CURVE + CURVE.length ? CURVE[context - FIRST_OF_CURVE] : 32704;
}

/** 8 log2(x), piecewise linear; x >= 8. */
function logarithm(x) {
  const high = Math.floor(x / 2 ** 32);
  const whole = high > 0 ? 63 - Math.clz32(high) : 31 - Math.clz32(x);
  return 8 * whole + (Math.floor(x / 2 ** (whole - 3)) % 8);
}

function magnitudeOf(scale, m) {
  return Math.floor((2 * m * (scale % 2 === 0 ? 16 : 23) * 2 ** (scale >> 1)) / 512);
}

function expectedScale(speeds, m) {
  const sum = speeds.reduce((total, speed) => total + speed, 0);
  let scale = 0;
  while (scale < MAX_SCALE && 27 * speeds.length * magnitudeOf(scale + 1, m) <= 32 * sum) ++scale;
  return scale;
}

/** Foretells the magnitudes of residuals. */
class Contexts {
  constructor(m, channels, scale, speeds) {
    this.channels = channels;
    this.speeds = speeds;
    this.unit = logarithm(128 * m) - 96;
    this.base = 16 * magnitudeOf(scale, m) + (m >> 1) + 8;
    this.recent = new Array(channels).fill(16 * magnitudeOf(scale, m));
  }
  next(n) {
    const context = logarithm(this.base + 16 * this.speeds[n] + 3 * this.recent[n % this.channels]) - this.unit;
    return Math.min(Math.max(context, 0), 159);
  }
  add(n, magnitude) {
    this.recent[n % this.channels] += Math.floor((16 * magnitude - this.recent[n % this.channels]) / 8);
  }
}

/** q at another step, or null where it leaves the range. */
function rescale(q, from, to) {
  if (from === to || q === 0) return q;
  const fourth = ((from - to) % 4 + 4) % 4;
  const shift = 30 - (from - to - fourth) / 4;
  if (shift > 61) return 0;
  if (shift < 0) return null;
  const product = BigInt(Math.abs(q)) * FOURTH_ROOTS[fourth];
  const magnitude = Number(shift === 0 ? product : (product + (1n << BigInt(shift - 1))) >> BigInt(shift));
  if (magnitude > MAX_VALUE) return null;
  return q > 0 ? magnitude : 0 - magnitude;
}

/** n / d to the nearest integer, halves away from zero. BigInt. */
function roundedQuotient(n, d) {
  const magnitude = (2n * (n < 0n ? -n : n) + d) / (2n * d);
  return n < 0n ? -magnitude : magnitude;
}

/** How far an estimate goes, in units of 1/(65536 of) of the newest key's movement. */
function estimateWeight(damped, at, of) {
  if (!damped) return 65536 * at;
  let moved = 0, interval = 55296;
  for (; at >= of; at -= of) {
    moved += interval * of;
    interval = Math.floor((27 * interval + 16) / 32);
  }
  return moved + interval * at;
}

function inRange(value) {
  require(Math.abs(value) <= MAX_VALUE, 'value out of range');
  return value;
}

function readExact(section, c1, into) {
  const head = section.u8();
  require(head >> 6 === 2, 'reserved bits');
  const fromNewer = (head & 32) !== 0;
  require(!fromNewer || c1 !== null, 'exact run without the newer key');
  const parameter = head & 31;
  const bits = new BitReader(section.bytes.subarray(section.at));
  for (let i = 0; i < into.length; ++i) {
    let value = fromNewer ? c1[i] : 0;
    if (parameter !== 31) {
      let quotient = 0;
      while (quotient < 24 && bits.bit() === 1) ++quotient;
      if (quotient < 24) {
        const z = quotient * 2 ** parameter + bits.number(parameter);
        value += z % 2 === 0 ? z / 2 : -(z + 1) / 2;
      } else {
        value = bits.number(32) | 0;
      }
    }
    into[i] = inRange(value);
  }
  while (bits.at % 8 !== 0) require(bits.bit() === 0, 'padding set');
  section.take(bits.at / 8);
}

function readCoarse(section, m, channels, c1, c2, into) {
  require(c1 !== null, 'coarse run without the newer key');
  const older = c2 ?? c1;
  const speeds = c1.map((c, i) => Math.abs(c - older[i]));
  const coder = new RangeDecoder(section.rest());
  const scale = coder.scale(expectedScale(speeds, m));
  require(scale >= 0 && scale <= MAX_SCALE, 'scale');
  const speed = 2 * (coder.number(4) - 4);
  const restoring = (coder.decision() ? coder.number(4) : 12) - 12;
  readLevels(coder, new Contexts(m, channels, scale, speeds), m, into,
    (i) => c1[i] + Math.floor((speed * (c1[i] - older[i]) + restoring * c1[i] + 8) / 16));
}

/** A run predicted from the memory: e its pose, e1 that of the newer key, if that was predicted from it. */
function readRecalled(section, m, channels, c1, c2, e, e1, into) {
  require(c1 !== null, 'coarse run without the newer key');
  const older = c2 ?? c1, before = e1 ?? e;
  const speeds = c1.map((c, i) => Math.abs(c - older[i]));
  const expected = expectedScale(speeds, m);
  const coder = new RangeDecoder(section.rest());
  const scale = coder.scale(Math.min(expected, 5));
  require(scale >= 0 && scale <= MAX_SCALE, 'scale');
  const hold = 2 * (coder.decision() ? 1 + coder.number(2) : 0);
  const speed = (coder.decision() ? coder.number(4) : 4) - 4;
  const shift = Math.max(0, expected - scale) >> 1;
  readLevels(coder, new Contexts(m, channels, scale, speeds.map((s) => Math.floor(s / 2 ** shift))), m, into,
    (i) => e[i] + Math.floor((hold * (c1[i] - before[i]) + speed * (c1[i] - older[i]) + 4) / 8));
}

function readLevels(coder, contexts, m, into, predicted) {
  let state = 0;
  for (let i = 0; i < into.length; ++i) {
    let value = predicted(i);
    const rule = state >> 1;
    const context = contexts.next(i);
    const level = coder.level(more(context - (rule === 0 ? 12 : 0)), more(context - (rule === 0 ? 20 : 19)), more(context - 18));
    const residual = level > 0 ? m * (2 * level - rule) : 0;
    if (level > 0) value += coder.decision() ? -residual : residual;
    contexts.add(i, residual);
    state = NEXT_STATE[state][level % 2];
    into[i] = inRange(value);
  }
  coder.finish();
}

/** Frames of one stream and epoch. */
export class FrameDecoder {
  #format;
  #segments = [];
  #poseCount = 0;
  #phase = null;
  #older = null;
  #newer = null;
  #number = null;
  #captureUs = 0n;
  #ageUs = 0n;

  constructor(format) {
    this.#format = { channels: 3, velocity_channels: 0, velocity_us: 1_000_000, ...format };
  }

  /** Forgets the chain: only a join helps. */
  restart() {
    this.#older = this.#newer = this.#number = null;
  }

  /** Keeps the first `count` segments of the memory: `kept` of a `remember`. */
  keepSegments(count) {
    this.#poseCount = this.#segments[count]?.first ?? this.#poseCount;
    this.#segments.length = Math.min(count, this.#segments.length);
  }

  /** Appends a segment to the memory that keys may be predicted from; `asset`: the 32 bytes of its id. */
  addSegment(asset, bytes) {
    const reader = new Reader(bytes);
    require(this.#quantised && [...SEGMENT_MAGIC, ...asset].every((byte) => reader.u8() === byte), 'no segment of this asset');
    const { channels, rows, band_ends: ends } = this.#format;
    require(reader.u8() === channels && reader.u8() === ends.length && ends.every((end) => reader.varint() === BigInt(end)), 'another layout');
    const count = reader.varint(), all = BigInt(this.#poseCount) + count;
    require(count > 0n && all <= MAX_POSES && all * BigInt(4 * rows * channels) <= MAX_MEMORY_BYTES, 'size of the memory');
    const chain = new FrameDecoder(this.#format), poses = [], bands = 2 ** ends.length - 1;
    while (poses.length < count) {
      const length = reader.varint();
      require(length <= bytes.length, 'ends early');
      poses.push(chain.#addPose(bands, new Reader(reader.take(Number(length)))));
    }
    reader.finish();
    require(poses.every((pose) => pose.step === poses[0].step), 'a pose of another step');
    this.#segments.push({ first: this.#poseCount, step: poses[0].step, poses: poses.map((pose) => pose.values) });
    this.#poseCount += poses.length;
  }

  #addPose(bands, payload) {
    if (this.#newer === null) this.#readJoin(bands, payload);
    else [this.#older, this.#newer] = [this.#newer, this.#readKey(bands, payload, this.#newer, this.#older)];
    return this.#newer;
  }

  #segmentOf(phase) {
    return this.#segments.findLast(({ first }) => first <= phase >> 3);
  }

  #has(phase) {
    if (phase < 0 || phase >= 8 * this.#poseCount) return false;
    const segment = this.#segmentOf(phase);
    return phase % 8 === 0 || (phase >> 3) + 1 < segment.first + segment.poses.length;
  }

  /** The band's values of the memory at a phase. */
  #recall(phase, step, band) {
    const segment = this.#segmentOf(phase), [first, last] = this.#range(band), f = phase % 8;
    const [p0, p1, p2, p3] = [-1, 0, 1, 2].map((n) => {
      const i = (phase >> 3) - segment.first + n;
      return segment.poses[Math.min(Math.max(i, 0), segment.poses.length - 1)].slice(first, last);
    });
    const w0 = -f * (8 - f) ** 2, w1 = (3 * f - 40) * f * f + 1024, w2 = (32 - 3 * f) * f * f + 64 * f, w3 = -f * f * (8 - f);
    return p1.map((value, i) => {
      const between = f === 0 ? value : Math.floor((w0 * p0[i] + w1 * value + w2 * p2[i] + w3 * p3[i] + 512) / 1024);
      const there = rescale(inRange(between), segment.step, step);
      require(there !== null, 'the memory leaves the range');
      return there;
    });
  }

  #readRecalledKey(bands, payload) {
    const [m, step] = this.#readHead(payload, this.#newer);
    require(m > 0 && this.#quantised, 'exact, and from a memory');
    const code = payload.varint(), before = this.#phase;
    const phase = Number(BigInt(before ?? 0) + (code % 2n === 0n ? code / 2n : -(code + 1n) / 2n));
    require(this.#has(phase) && (before === null || this.#has(before)), 'phase');
    const key = this.#emptyKey(bands, step);
    this.#eachSection(bands, payload, (band, section) => {
      const c1 = this.#reference(this.#newer, band, step);
      const c2 = c1 === null ? null : this.#reference(this.#older, band, step);
      const e = c1 === null ? null : this.#recall(phase, step, band);
      const e1 = c1 === null || before === null ? null : this.#recall(before, step, band);
      if (section.peek() === EXACT_FOLLOWS) return this.#readRun(section, m, c1, c2, band, key);
      const [first, last] = this.#range(band), run = new Array(last - first);
      readRecalled(section, m, this.#format.channels, c1, c2, e, e1, run);
      run.forEach((value, i) => { key.values[first + i] = value; });
    });
    this.#phase = phase;
    return key;
  }

  decode(bytes) {
    require(bytes.length <= MAX_FRAME_BYTES, 'size of the frame');
    const reader = new Reader(bytes);
    const first = reader.u8(), kind = first & 7;
    require(kind >= 1 && kind <= 4, 'kind');
    const flags = first >> 3, isKey = kind <= 2, isJoin = kind === 2;
    require((flags & (isKey ? ~(AHEAD | RECALLED) : kind === 3 ? ~RESIDUAL : ~0)) === 0, 'flags');
    const recalled = isKey && flags >= RECALLED;
    const streamId = reader.varint(), tag = reader.u8(), check = isJoin ? 0 : reader.u8();
    require(streamId < 2n ** 32n, 'stream id');
    const step = isKey && (flags & AHEAD) === 0 ? 0 : reader.u8(), at = step >> 4, of = step & 15;
    require((isKey && step === 0) || (at >= 1 && of >= 1 && (at < of || (at === of && !isKey) || kind === 4)), 'step');
    const hasBands = isKey || flags === RESIDUAL, bands = hasBands ? reader.u8() : 0;
    require(bands < 2 ** this.#format.band_ends.length, 'unknown bands');
    const joined = isJoin ? [reader.varint(), reader.varint(), reader.varint()] : [];
    require(!isJoin || (joined[1] <= MAX_TIME && joined[2] <= joined[1]), 'capture time or age');
    const coded = kind === 1 ? reader.varint() : 0n, delayUs = coded % 2n === 0n ? coded / 2n : -(coded + 1n) / 2n;
    require(delayUs <= MAX_TIME && delayUs >= -MAX_TIME, 'capture time');
    const payload = new Reader(reader.rest());
    require(hasBands === (bands !== 0) && hasBands === (payload.bytes.length > 0), 'bands or payload');

    const [sequence, captureUs] = isJoin ? joined : this.#resolved(kind, check, at, of, delayUs);
    if (sequence === null) {
      if (kind === 1) this.restart();
      return null;
    }
    const frame = { kind: KINDS[kind], flags: isKey ? flags : 0, bands, at, of, streamId: Number(streamId), tag, sequence, captureUs };
    if (isJoin) {
      frame.ageUs = joined[2];
      this.#readJoin(bands, payload, recalled);
      [this.#number, this.#captureUs, this.#ageUs] = joined;
      Object.assign(frame, { older: this.#older, newer: this.#newer });
    } else if (kind === 1) {
      if (recalled) frame.pose = this.#readRecalledKey(bands, payload);
      else [frame.pose, this.#phase] = [this.#readKey(bands, payload, this.#newer, this.#older), null];
      [this.#older, this.#newer, this.#number] = [this.#newer, frame.pose, sequence];
      this.#ageUs = captureUs - this.#captureUs;
      this.#captureUs = captureUs;
    } else {
      frame.pose = kind === 4 ? this.#estimate(at, of) : this.#interpolate(at, of);
      if (bands !== 0) this.#correct(frame.pose, bands, payload);
    }
    return isKey && at > 0 ? { ...frame, shown: this.#interpolate(at, of) } : frame;
  }

  #correct(pose, bands, payload) {
    require((bands & ~pose.bands) === 0, 'residual of a band that the pose lacks');
    const residual = this.#readKey(bands, payload, pose, null);
    require(residual.step === pose.step, 'step of a residual');
    this.#eachValue(bands, (i) => { pose.values[i] = residual.values[i]; });
  }

  /** Sequence and capture time of a frame that follows the newest key; null twice where it does not. */
  #resolved(kind, check, at, of, delayUs) {
    const none = [null, null];
    if (this.#number === null) return none;
    const sequence = this.#number + (kind === 1 ? 1n : 0n);
    const part = kind === 1 ? this.#ageUs : this.#ageUs * BigInt(at) / BigInt(of);
    const captureUs = this.#captureUs + part + delayUs - (kind === 3 ? this.#ageUs : 0n);
    const follows = Number(sequence & 255n) === check && sequence < 2n ** 64n;
    if (!follows || captureUs < 0n || captureUs > MAX_TIME || (kind === 1 && captureUs <= this.#captureUs)) return none;
    return [sequence, captureUs];
  }

  get #quantised() {
    return this.#format.codec === 'quantised';
  }

  #emptyKey(bands, step) {
    const size = this.#format.rows * this.#format.channels;
    return { bands, step, values: this.#quantised ? new Array(size).fill(0) : new Float64Array(size) };
  }

  #range(band) {
    const ends = this.#format.band_ends;
    return [band === 0 ? 0 : ends[band - 1] * this.#format.channels, ends[band] * this.#format.channels];
  }

  #reference(key, band, step) {
    if (key === null || !this.#quantised || (key.bands >> band & 1) === 0) return null;
    const [first, last] = this.#range(band);
    const values = key.values.slice(first, last).map((q) => rescale(q, key.step, step));
    return values.includes(null) ? null : values;
  }

  /** m and step; `newer` is the key whose step holds where none is said. */
  #readHead(payload, newer = null) {
    const first = payload.u8();
    if ((first & 3) === SAME_STEP && newer !== null && this.#quantised) return [first >> 2, newer.step];
    require(CODECS[first & 3] === this.#format.codec, 'codec');
    const step = this.#readStep(payload);
    return [first >> 2, step];
  }

  #readStep(payload) {
    const step = payload.u8();
    require(this.#quantised || step === 0, 'step of a float codec');
    return step;
  }

  #eachSection(bands, payload, visit) {
    for (let band = 0; band < this.#format.band_ends.length; ++band) {
      if ((bands >> band & 1) === 0) continue;
      const length = payload.varint();
      require(length <= MAX_FRAME_BYTES, 'ends early');
      const section = new Reader(payload.take(Number(length)));
      visit(band, section);
      section.finish();
    }
    payload.finish();
  }

  #readRun(section, m, c1, c2, band, key) {
    const [first, last] = this.#range(band);
    if (!this.#quantised) {
      const size = this.#format.codec === 'float64' ? 8 : 4;
      for (let i = first; i < last; ++i) {
        const bytes = section.take(size);
        const view = new DataView(bytes.buffer, bytes.byteOffset, size);
        key.values[i] = size === 8 ? view.getFloat64(0, true) : view.getFloat32(0, true);
        require(Number.isFinite(key.values[i]), 'not finite');
      }
      return;
    }
    const run = new Array(last - first);
    if (m > 0 && section.peek() !== EXACT_FOLLOWS) {
      readCoarse(section, m, this.#format.channels, c1, c2, run);
    } else {
      if (m > 0) section.u8();
      readExact(section, c1, run);
    }
    for (let i = 0; i < run.length; ++i) key.values[first + i] = run[i];
  }

  #readKey(bands, payload, newer, older) {
    const [m, step] = this.#readHead(payload, newer);
    require(m === 0 || this.#quantised, 'spacing of a float codec');
    const key = this.#emptyKey(bands, step);
    this.#eachSection(bands, payload, (band, section) => {
      const c1 = this.#reference(newer, band, step);
      this.#readRun(section, m, c1, c1 === null ? null : this.#reference(older, band, step), band, key);
    });
    return key;
  }

  #readJoin(bands, payload, recalled = false) {
    const [m, step] = this.#readHead(payload);
    require(m === 0, 'spacing of a join');
    const olderStep = this.#readStep(payload);
    const olderBands = payload.u8();
    const phase = recalled ? payload.varint() : null;
    require(phase === null || (this.#quantised && phase < 2n ** 32n && this.#has(Number(phase))), 'phase');
    require((olderBands & ~bands) === 0, 'older bands');
    const older = this.#emptyKey(olderBands, olderStep), newer = this.#emptyKey(bands, step);
    this.#eachSection(bands, payload, (band, section) => {
      if ((olderBands >> band & 1) !== 0) this.#readRun(section, 0, null, null, band, older);
      this.#readRun(section, 0, this.#reference(older, band, step), null, band, newer);
    });
    this.#older = older;
    this.#newer = newer;
    this.#phase = phase === null ? null : Number(phase);
  }

  /** Calls visit(index) for each value of the bands. */
  #eachValue(bands, visit) {
    for (let band = 0; band < this.#format.band_ends.length; ++band) {
      if ((bands >> band & 1) === 0) continue;
      const [first, last] = this.#range(band);
      for (let i = first; i < last; ++i) visit(i);
    }
  }

  #set(pose, i, value) {
    pose.values[i] = this.#format.codec === 'float32' ? Math.fround(value) : value;
  }

  #interpolate(at, of) {
    const a = this.#older, b = this.#newer;
    const pose = this.#emptyKey(a.bands & b.bands, b.step);
    this.#eachValue(pose.bands, (i) => {
      if (!this.#quantised) return this.#set(pose, i, at === of ? b.values[i] : a.values[i] + ((b.values[i] - a.values[i]) * at) / of);
      const start = rescale(a.values[i], a.step, b.step);
      require(start !== null, 'interpolation leaves the range');
      const d = b.values[i] - start;
      const magnitude = Math.floor((2 * Math.abs(d) * at + of) / (2 * of));
      pose.values[i] = start + (d >= 0 ? magnitude : -magnitude);
    });
    if (this.#format.scheme === 'hermite') this.#bend(pose, at, of);
    return pose;
  }

  /** Moves the channels that have velocities from the straight line onto Hermite's cubic. */
  #bend(pose, at, of) {
    const a = this.#older, b = this.#newer;
    const { channels, velocity_channels: count, velocity_us: unitUs } = this.#format;
    if (count === 0 || at === of || this.#ageUs <= 0n || this.#ageUs > LONGEST_HERMITE_US) return;
    const to = at * at * (3 * of - 2 * at), slope0 = at * (of - at) ** 2, slope1 = -at * at * (of - at), whole = of ** 3;
    this.#eachValue(pose.bands, (i) => {
      if (i % channels >= count) return;
      const v = i + channels - count;
      if (!this.#quantised) {
        const slopes = a.values[v] * slope0 + b.values[v] * slope1;
        const moved = ((b.values[i] - a.values[i]) * to) / whole;
        this.#set(pose, i, a.values[i] + moved + (slopes * Number(this.#ageUs)) / unitUs / whole);
        return;
      }
      const p = rescale(a.values[i], a.step, b.step), w = rescale(a.values[v], a.step, b.step);
      require(p !== null && w !== null, 'interpolation leaves the range');
      const slopes = BigInt(w) * BigInt(slope0) + BigInt(b.values[v]) * BigInt(slope1);
      const bent = roundedQuotient(slopes * this.#ageUs, BigInt(unitUs));
      require(bent <= 2n ** 50n && -bent <= 2n ** 50n, 'interpolation leaves the range');
      pose.values[i] = inRange(p + Number(roundedQuotient(BigInt(b.values[i] - p) * BigInt(to) + bent, BigInt(whole))));
    });
  }

  #estimate(at, of) {
    const a = this.#older, b = this.#newer;
    const weight = estimateWeight(this.#format.scheme === 'damped', at, of);
    const pose = { bands: b.bands, step: b.step, values: b.values.slice() };
    this.#eachValue(a.bands & b.bands, (i) => {
      if (!this.#quantised) {
        return this.#set(pose, i, b.values[i] + (weight / (65536 * of)) * (b.values[i] - a.values[i]));
      }
      const start = rescale(a.values[i], a.step, b.step);
      require(start !== null, 'estimation leaves the range');
      const moved = roundedQuotient(BigInt(b.values[i] - start) * BigInt(weight), BigInt(65536 * of));
      pose.values[i] = inRange(b.values[i] + Number(moved));
    });
    return pose;
  }
}
