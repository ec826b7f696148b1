// SPDX-License-Identifier: MIT
import { kCividis, kCoolwarm, kGrey, kTurbo, kViridis } from '../../../view/style.cpp';
import type { StreamInfo } from '../client/control.js';
import type { AssetFacts } from '../core/asset.js';
import type { LiveSurface } from './live_surface.js';
import type { Colouring, ColourMap, Style } from './style.js';

// Numbers as colours: view/paint.h. Loaded where a style asks for them.

const MAX_INTERVAL_US = 1_000_000;  // Poses further apart give no speed.
const DIGITS = [1, 1.5, 2, 3, 4, 5, 6, 8];

export interface Legend {
  title: string;
  unit: string;
  low: number;
  high: number;
  /** From the lowest value to the highest, evenly spaced, #rrggbb. */
  colours: readonly string[];
}
/** Of a stream's pose. */
export interface NumberedPose {
  coefficients: Float64Array;
  channels: number;
  rest: Float64Array;
  timeUs: bigint | undefined;
  info: StreamInfo | undefined;
  live?: Pick<LiveSurface, 'other'>;
}

const COLOURS: Record<ColourMap, readonly number[]> = { viridis: kViridis, cividis: kCividis, coolwarm: kCoolwarm, turbo: kTurbo, grey: kGrey };

/** 256 colours, RGBA. */
export function tableOf(map: ColourMap): Uint8Array {
  const colours = COLOURS[map];
  return Uint8Array.from({ length: 1024 }, (_, i) => {
    if (i % 4 === 3) return 255;
    const at = ((i >> 2) / 255) * (colours.length - 1), k = Math.min(Math.floor(at), colours.length - 2), u = at - k, shift = 16 - 8 * (i % 4);
    return Math.round((1 - u) * ((colours[k]! >> shift) & 255) + u * ((colours[k + 1]! >> shift) & 255));
  });
}

/** The smallest of 1, 1.5, 2, 3, 4, 5, 6, 8 times a power of ten that is at least `value`. */
export function roundUp(value: number): number {
  const power = 10 ** Math.floor(Math.log10(value));
  return (DIGITS.find((digit) => digit * power >= value * (1 - 1e-6)) ?? 10) * power;
}

/** `count` columns from `first` on, times `scale`, as rank x 3. */
function columnsOf({ coefficients, channels }: NumberedPose, first: number, count: number, scale = 1): Float64Array {
  const made = new Float64Array((coefficients.length / channels) * 3);
  for (let k = 0; k < made.length / 3; ++k) for (let d = 0; d < count; ++d) made[3 * k + d] = scale * coefficients[k * channels + first + d]!;
  return made;
}

/** What one surface's colours say from now on, and the range that has been seen of it, which never shrinks, so that they do not flicker. */
export class NumberPainter {
  readonly #colour: Colouring;
  #seen: readonly [number, number] | undefined;
  #info: StreamInfo | undefined;
  #before: Float64Array | undefined;
  #beforeUs: bigint | undefined;
  #difference: Float64Array | undefined;

  constructor(colour: Colouring) {
    this.#colour = colour;
  }
  /** For the worker; nothing: the stream has no such channel. */
  of(pose: NumberedPose): { coefficients: Float64Array; isLength: boolean } | undefined {
    this.#info = pose.info;
    if (this.#colour === 'movement') return { coefficients: columnsOf(pose, 0, 3).map((value, i) => value - pose.rest[i]!), isLength: true };
    if (this.#colour === 'difference') {
      const other = pose.live?.other?.(), difference = columnsOf(pose, 0, 3).map((value, i) => value - other?.[i]!);
      return other?.length === difference.length ? { coefficients: difference, isLength: true } : undefined;
    }
    if (this.#colour === 'speed') return { coefficients: this.#speed(pose), isLength: true };
    const known = pose.info?.format?.scalars ?? [], which = this.#colour.slice('channel:'.length);
    const k = /^\d+$/.test(which) ? Number(which) - 3 : known.findIndex(({ name }) => name === which);
    return k < 0 || 3 + k >= pose.channels ? undefined : { coefficients: columnsOf(pose, 3 + k, 1), isLength: false };
  }
  include([low, high]: readonly [number, number]): void {
    this.#seen = [Math.min(low, this.#seen?.[0] ?? low), Math.max(high, this.#seen?.[1] ?? high)];
  }
  /** Between round numbers; symmetric for values of both signs. */
  span({ colourRange }: Style): readonly [number, number] {
    const scalar = this.#scalar;
    if (colourRange) return colourRange;
    if (scalar && scalar.low < scalar.high) return [scalar.low, scalar.high];
    if (!this.#seen) return [0, 1];
    const largest = Math.max(...this.#seen.map(Math.abs)), end = largest > 1e-30 ? roundUp(largest) : 1;
    return [this.#seen[0] < 0 ? -end : 0, end];
  }
  /** Nothing while no number is known. */
  legend(style: Style, { metresPerUnit }: AssetFacts): Legend | undefined {
    if (!this.#seen) return undefined;
    const scalar = this.#scalar, isScalar = this.#colour.startsWith('channel:'), inMetres = metresPerUnit > 0, [low, high] = this.span(style);
    const scale = inMetres && !isScalar ? metresPerUnit : 1, length = inMetres ? 'm' : 'units';
    return {
      title: this.#colour === 'movement' ? 'movement from rest' : this.#colour === 'difference' ? 'difference' : isScalar ? (scalar?.name ?? this.#colour.replace(':', ' ')) : 'speed',
      unit: isScalar ? (scalar?.unit ?? '') : this.#colour === 'speed' ? `${length}/s` : length,
      low: scale * low, high: scale * high, colours: COLOURS[style.colourMap].map((colour) => `#${colour.toString(16).padStart(6, '0')}`),
    };
  }

  get #scalar(): NonNullable<StreamInfo['format']>['scalars'][number] | undefined {
    const which = this.#colour.slice('channel:'.length), known = this.#info?.format?.scalars ?? [];
    return this.#colour.startsWith('channel:') ? (known.find(({ name }) => name === which) ?? known[Number(which) - 3]) : undefined;
  }
  /** From the stream's velocities, else from the pose before. */
  #speed(pose: NumberedPose): Float64Array {
    const { channels, timeUs = 0n } = pose, format = pose.info?.format;
    if (format && format.velocity_channels >= 3 && format.channels === channels)
      return columnsOf(pose, channels - format.velocity_channels, 3, 1e6 / format.velocity_us);
    const now = columnsOf(pose, 0, 3), before = this.#before;
    if (this.#beforeUs !== undefined && this.#beforeUs !== timeUs && before?.length === now.length) {
      const step = Number(timeUs - this.#beforeUs);
      this.#difference = now.map((value, i) => (step > 0 && step <= MAX_INTERVAL_US ? ((value - before[i]!) * 1e6) / step : 0));
    }
    if (this.#difference?.length !== now.length) this.#difference = new Float64Array(now.length);
    if (this.#beforeUs !== timeUs || !before) this.#before = now;
    this.#beforeUs = timeUs;
    return this.#difference;
  }
}
