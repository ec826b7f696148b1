// SPDX-License-Identifier: MIT
import type { Broker, Stream } from '../client/client.js';
import type { Profile } from '../client/profile.js';
import type { Pose } from '../client/subscription.js';
import { poseBetween, type TimedPose } from '../core/curve.js';
import type { View } from '../view/view.js';
import type { part } from './parts.js';

// How far two streams of one surface are apart, from their coefficients: client/compared_source.h.

const MAX_POSES = 128, EVERY_MS = 250;
/** Of the shortest ways of two streams from their senders' clocks to ours: closer ones are of one clock. */
const ONE_CLOCK_US = 50_000;

/** Columns 0 to 2: rank x 3. */
export function positionsOf({ coefficients, channels }: Pick<Pose, 'coefficients' | 'channels'>): Float64Array {
  return channels === 3 ? coefficients : coefficients.filter((_, i) => i % channels < 3);
}

/** The last poses of a stream, by capture time. */
export class History {
  /** From the sender's clock to ours, the shortest so far. */
  wayUs = Infinity;
  #epoch = -1;
  #poses: TimedPose[] = [];

  add(pose: Pick<Pose, 'epoch' | 'captureUs' | 'arrivalUs' | 'coefficients' | 'channels'>): void {
    if (pose.epoch !== this.#epoch) [this.#epoch, this.#poses, this.wayUs] = [pose.epoch, [], Infinity];
    const timeUs = Number(pose.captureUs);
    this.wayUs = Math.min(this.wayUs, pose.arrivalUs - timeUs);
    if (timeUs <= (this.#poses.at(-1)?.timeUs ?? -1)) return;
    this.#poses.push({ timeUs, coefficients: positionsOf(pose) });
    if (this.#poses.length > MAX_POSES) this.#poses.shift();
  }
  /** Interpolated as a playout does it; before the first and behind the last these. */
  at(timeUs: number): Float64Array | undefined {
    const i = this.#poses.findIndex((pose) => pose.timeUs > timeUs);
    return i > 0 ? poseBetween(this.#poses, i - 1, timeUs) : this.#poses.at(i)?.coefficients;
  }
}
/** A time of the first stream, on the clock of the second one's sender. */
export function otherTime(timeUs: number, first: History, second: History): number {
  const apartUs = first.wayUs - second.wayUs;
  return Math.abs(apartUs) < ONE_CLOCK_US ? timeUs : timeUs + apartUs;
}

/** Colours a view by the distance to another stream of its broker, and says how much that is. */
export function compare(view: View, broker: Broker, name: string, profile: Profile, make: typeof part): HTMLElement {
  const said = make('p', { class: 'figures compared', role: 'status' }, `comparing with ${name}`), { live } = view;
  const one: Stream = live.stream, other = broker.watch(name, { profile, isPreview: true }), first = new History(), second = new History();
  let fault = '';
  one.on('pose', (pose) => first.add(pose));
  other.on('pose', (pose) => second.add(pose));
  other.on('error', ({ message }) => (fault = message));
  live.other = () => {
    if (live.shownUs === undefined || one.surface?.asset !== other.surface?.asset) return undefined;
    return second.at(otherTime(Number(live.shownUs), first, second));
  };
  view.setStyle({ colour: 'difference' });
  setInterval(() => {
    const { surface } = one, { rebuilt, numbered } = (view.style.colour === 'difference' && live.drawn) || {}, numbers = rebuilt?.numbers;
    if (fault === '' && surface && other.surface && surface.asset !== other.surface.asset) said.textContent = `${name} shows another surface: only streams of one surface can be compared`;
    else if (fault !== '' || !surface || !numbers || !numbered) said.textContent = fault || `comparing with ${name}: ${other.status?.detail ?? ''}`;
    else {
      const { boxLow, boxHigh, area } = surface.facts, diagonal = Math.hypot(...boxLow.map((low, d) => boxHigh[d]! - low)), percent = (x: number): string => `${Number(((100 * x) / diagonal).toPrecision(3))} %`;
      said.textContent = `difference from ${name}: rms ${percent(Math.sqrt(numbered.reduce((sum, value) => sum + value * value, 0) / area))}, largest ${percent(numbers.reduce((most, value) => Math.max(most, value), 0))} of the diagonal`;
    }
  }, EVERY_MS);
  return said;
}
