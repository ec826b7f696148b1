// SPDX-License-Identifier: MIT
import { compiled, Stream, workerFailure } from '../client/client.js';
import { defaults } from '../client/defaults.js';
import { surroundings } from '../client/environment.js';
import { poseBetween, type TimedPose } from '../core/curve.js';
import { EigencastError } from '../core/module.js';
import type { Playing, Shown, ShownPose } from '../core/playout.js';
import type { ToPlayer } from './session.js';
import type { FromPlayer } from './worker.js';

/** So much is read ahead, at normal speed, and kept behind. */
const AHEAD_US = 2_000_000, BEHIND_US = 3_000_000;
/** Between poses further apart nothing is interpolated. */
const GAP_US = 1_000_000;
/** A page that nobody saw goes on where it was. */
const LONGEST_TURN_US = 250_000;

/**
 * Plays a recording's poses: which of them is shown is a matter of its position, not of when it came. Positions are
 * microseconds since the recording's start.
 */
export class Player implements Playing {
  readonly durationUs: number;
  isLooping = true;
  #isPlaying = true;
  #speed = 1;
  #positionUs = 0;
  #clockUs: number | undefined;
  #poses: TimedPose[] = [];
  #shown: ShownPose | undefined;
  #askedUntilUs = -1;
  #readUntilUs = -1;
  /** Poses on their way since before the last seek are none of its. */
  #seeks = 0;
  #isSought = false;
  readonly #read: (fromUs: number, untilUs: number, seek: number) => void;

  /** read  asks for the poses of a time: with another `seek` from there, else on from what it asked for last. sought(seek) comes, add(), then done() */
  constructor(durationUs: number, read: (fromUs: number, untilUs: number, seek: number) => void) {
    this.durationUs = durationUs;
    this.#read = read;
    this.seek(0);
  }
  get positionUs(): number {
    return this.#positionUs;
  }
  get isPlaying(): boolean {
    return this.#isPlaying;
  }
  set isPlaying(is: boolean) {
    if (is && this.#positionUs >= this.durationUs) this.seek(0);
    this.#isPlaying = is;
  }
  get speed(): number {
    return this.#speed;
  }
  set speed(speed: number) {
    this.#speed = speed;
    this.#askAhead();
  }
  seek(timeUs: number): void {
    this.#positionUs = Math.min(Math.max(timeUs, 0), this.durationUs);
    const isThere = this.#poses.length > 0 && this.#poses[0]!.timeUs <= this.#positionUs && this.#positionUs <= this.#readUntilUs;
    if (!isThere) {
      this.#poses = [];
      this.#readUntilUs = this.#askedUntilUs = -1;
      this.#isSought = false;
      ++this.#seeks;
    }
    this.#askAhead();
  }
  /** One pose on or back, and halts there. */
  step(by: 1 | -1): void {
    this.#isPlaying = false;
    const at = this.#positionUs, poses = this.#poses;
    const next = by > 0 ? poses.find(({ timeUs }) => timeUs > at + 1) : poses.filter(({ timeUs }) => timeUs < at - 1).at(-1);
    this.seek(next?.timeUs ?? at + by * 33_333);
  }
  /** Poses from the place of a seek follow. */
  sought(seek: number): void {
    this.#isSought ||= seek === this.#seeks;
  }
  /** What was asked for has come. */
  done(untilUs: number): void {
    if (this.#isSought) this.#readUntilUs = Math.max(this.#readUntilUs, untilUs);
  }

  set(): void {}
  setBandEnds(): void {}
  addNext(): void {}
  free(): void {}
  get delayUs(): number {
    return 0;
  }
  reset(): void {
    this.#poses = [];
    this.#shown = undefined;
  }
  add(timeUs: bigint, _arrivalUs: bigint, coefficients: ArrayLike<number>): boolean {
    if (!this.#isSought) return false;
    const time = Number(timeUs), last = this.#poses.at(-1);
    if (last && time <= last.timeUs) this.#poses = this.#poses.filter((pose) => pose.timeUs < time);
    this.#poses.push({ timeUs: time, coefficients: Float64Array.from(coefficients) });
    return true;
  }
  /** Moves the position on, and interpolates between the poses beside it; what has not come leaves the last. */
  at(nowUs: bigint): ShownPose | undefined {
    const now = Number(nowUs), since = Math.min(now - (this.#clockUs ?? now), LONGEST_TURN_US), poses = this.#poses;
    this.#clockUs = now;
    const isRead = poses.some(({ timeUs }) => timeUs > this.#positionUs) || this.#positionUs <= this.#readUntilUs;
    // It waits for what is being read.
    if (this.#isPlaying && isRead && since > 0) this.#move(since * this.#speed);
    const i = this.#indexAt(this.#positionUs), before = poses[Math.max(i, 0)], next = poses[i + 1];
    if (!before || (i < 0 && !isRead) || (!next && !isRead)) return this.#shown;
    const wide = next && i >= 0 ? next.timeUs - before.timeUs : Infinity, u = wide < GAP_US ? (this.#positionUs - before.timeUs) / wide : 0;
    const coefficients = u === 0 ? before.coefficients : poseBetween(poses, i, this.#positionUs);
    const shown: Shown = wide >= GAP_US ? 'held' : u === 0 ? 'live' : 'interpolated';
    return (this.#shown = { timeUs: BigInt(Math.round(wide < GAP_US ? this.#positionUs : before.timeUs)), coefficients, bands: 255, shown, settling: false });
  }

  /** Of the last pose at or before a time; -1: there is none. */
  #indexAt(timeUs: number): number {
    const later = this.#poses.findIndex((pose) => pose.timeUs > timeUs);
    return (later < 0 ? this.#poses.length : later) - 1;
  }
  #move(byUs: number): void {
    const to = this.#positionUs + byUs;
    if (to < this.durationUs) {
      this.#positionUs = to;
      this.#poses = this.#poses.slice(Math.max(0, this.#indexAt(to - BEHIND_US)));
      return this.#askAhead();
    }
    if (this.isLooping) return this.seek(0);
    this.#positionUs = this.durationUs;
    this.#isPlaying = false;
  }
  #askAhead(): void {
    const ahead = AHEAD_US * Math.max(1, this.#speed), from = this.#positionUs;
    if (this.#askedUntilUs >= Math.min(from + ahead / 2, this.durationUs)) return;
    this.#askedUntilUs = from + ahead;
    this.#read(from, this.#askedUntilUs, this.#seeks);
  }
}

export interface Opened {
  stream: Stream;
  player: Player;
  module: WebAssembly.Module;
  name: string;
  startedMs: number;
}

/** A recording, or its URL, as a stream and what plays it. The worker is its own. Throws EigencastError. */
export async function openRecording(what: Blob | string, worker: Worker): Promise<Opened> {
  const module = await compiled(defaults.core, surroundings());
  const post = (message: FromPlayer, transfer: Transferable[] = []): void => worker.postMessage(message, transfer);
  const opened = new Promise<ToPlayer & { op: 'opened' }>((resolve, reject) => {
    worker.onerror = (event) => reject(new EigencastError('internal', workerFailure(event)));
    worker.onmessage = ({ data }: MessageEvent<ToPlayer>) => {
      if (data.op === 'opened') resolve(data);
      else if (data.op === 'failed') reject(new EigencastError(data.code, data.message));
    };
  });
  post({ op: 'open', what, module });
  const { stream: name, durationUs, startedMs } = await opened.catch((error: unknown) => {
    worker.terminate();
    throw error;
  });
  const stream = new Stream(name, 1, post, () => worker.terminate());
  post({ op: 'watch', key: 1, stream: name, profile: {}, maxBytes: 2 ** 30 });
  const player = new Player(durationUs, (fromUs, untilUs, seek) => post({ op: 'read', fromUs, untilUs, seek }));
  worker.onmessage = ({ data }: MessageEvent<ToPlayer>) => {
    if (data.op === 'sought') player.sought(data.seek);
    else if (data.op === 'read') player.done(data.untilUs);
    else if (data.op !== 'opened') stream.receive(data);
  };
  stream.playout = player;
  return { stream, player, module, name, startedMs };
}
