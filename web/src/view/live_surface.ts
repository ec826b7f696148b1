// SPDX-License-Identifier: MIT
import type { Stream } from '../client/client.js';
import type { Rebuilt } from '../client/protocol.js';
import type { Pose, Status, Surface } from '../client/subscription.js';
import { EigencastError, type Core } from '../core/module.js';
import { Playout, type Playing, type PlayoutSettings, type Shown } from '../core/playout.js';
import { nowUs } from './clock.js';
import { dot, IDENTITY, type Mat4, type Vec3 } from './matrix.js';
import type { NumberPainter } from './numbers.js';

const FADE_MS = 500;
/** From a cube's centre to its corners, edges and sides; along x these are 12 and 13, along y 10 and 15, along z 4 and 21. */
const DIRECTIONS = Array.from({ length: 27 }, (_, i): Vec3 => [(i % 3) - 1, (Math.floor(i / 3) % 3) - 1, Math.floor(i / 9) - 1]).filter((_, i) => i !== 13);

/** What is drawn, until the next one comes. */
export interface Drawn {
  rebuilt: Rebuilt;
  isCloud: boolean;
  area: number;
  /** Whose lengths or values its numbers are: rank x 3, or rank. */
  numbered: Float64Array | undefined;
}

/**
 * A stream's surface on the page: which pose is shown when, and how many of its vertices; the worker rebuilds it. Keeps
 * the last pose while none comes, and shows the rest pose before the first: view/surface_view.h.
 */
export class LiveSurface {
  readonly stream: Stream;
  readonly #playout: Playing;
  readonly #changed: (drawn: Drawn | undefined) => void;
  readonly #listeners: (() => void)[];
  #settings: PlayoutSettings = { mode: 'interpolate' };
  #surface: Surface | undefined;
  #epoch = -1;
  #asset = '';
  #coefficients: Float64Array | undefined;
  #channels = 3;
  /** Channels of poses that come. */
  #comes = 3;
  #shownUs: bigint | undefined;
  #isSettling = false;
  #level = 0;
  #isStale = false;
  #isTextured = false;
  #painter: NumberPainter | undefined;
  #points: Uint32Array | undefined;
  #isInFlight = false;
  #isClosed = false;
  #drawn: Drawn | undefined;
  #spare: Rebuilt | undefined;
  #version = 0;
  #lostSinceMs: number | undefined;
  /** Of the rest pose, surface units; grows more exact as the surface arrives. */
  box: [low: Vec3, high: Vec3] | undefined;
  /** Points that lie farthest along some directions. */
  outline: Vec3[] = [];
  shown: Shown = 'held';
  bands = 0;
  posesShown = 0;
  isPaused = false;
  /** Of a stream that this one is compared with: rank x 3, at the time that is shown. */
  other: (() => Float64Array | undefined) | undefined;
  /** Date.now() of the last pose that came. */
  newestMs: number | undefined;

  /** `changed`: there is something else to draw; nothing: the box is another. */
  constructor(stream: Stream, core: Core, changed: (drawn: Drawn | undefined) => void) {
    this.stream = stream;
    this.#changed = changed;
    this.#playout = stream.playout ?? new Playout(core, this.#settings);
    this.#listeners = [
      stream.on('pose', (pose) => this.#onPose(pose)),
      stream.on('surface', (surface) => this.#onSurface(surface)),
      stream.on('status', (status) => this.#onStatus(status)),
    ];
    queueMicrotask(() => {
      // What came before, once the owner has this surface.
      if (this.#isClosed) return;
      if (stream.status) this.#onStatus(stream.status);
      if (stream.surface) this.#onSurface(stream.surface);
      if (stream.pose) this.#onPose(stream.pose);
    });
  }
  /** The stream stays as it is. */
  close(): void {
    this.#isClosed = true;
    for (const stop of this.#listeners) stop();
    this.#playout.free();
  }

  get playout(): PlayoutSettings {
    return this.#settings;
  }
  set playout(settings: PlayoutSettings) {
    this.#settings = settings;
    this.#playout.set(settings);
  }
  get delayUs(): number {
    return this.#playout.delayUs;
  }
  /** On the sender's clock; nothing before the first pose. */
  get shownUs(): bigint | undefined {
    return this.#shownUs;
  }
  get surface(): Surface | undefined {
    return this.#surface;
  }
  get drawn(): Drawn | undefined {
    return this.#drawn;
  }
  get isCloud(): boolean {
    return this.#surface?.facts.faceTotal === 0;
  }
  get sceneFromSurface(): Mat4 {
    return this.stream.info?.world ?? IDENTITY;
  }
  /** 1, or less where the connection or its sender is lost. */
  colourfulness(nowMs: number): number {
    if (this.#lostSinceMs === undefined || this.newestMs === undefined) return 1;
    return Math.max(0, 1 - (nowMs - this.#lostSinceMs) / FADE_MS);
  }
  /** With UVs, where it has an image. */
  set isTextured(value: boolean) {
    this.#isStale ||= value !== this.#isTextured;
    this.#isTextured = value;
  }
  /** With numbers for the vertices. */
  set painter(painter: NumberPainter | undefined) {
    this.#isStale ||= painter !== this.#painter;
    this.#painter = painter;
  }
  /** Vertices by their numbers in the source, whose places come with what is drawn. */
  get points(): Uint32Array | undefined {
    return this.#points;
  }
  set points(points: Uint32Array | undefined) {
    this.#isStale ||= String(points) !== String(this.#points);
    this.#points = points;
  }
  /** Triangles and all come with the next answer, as after a lost GL context. */
  forgetDrawn(): void {
    this.#version = 0;
    this.#isStale = true;
  }

  /**
   * Chooses what is to be shown now, of at most `level` vertices, and has it rebuilt where that is something new.
   * pxPerUnit: of the screen, for the pace at which levels change; 0: at once.
   */
  advance(nowUs: number, level: number, pxPerUnit = 0): void {
    if (!this.#surface || this.#isInFlight) return;
    const isNew = this.#choose(nowUs);
    const wanted = Math.min(level, this.#surface.facts.rowsReady);
    if (!isNew && !this.#isStale && wanted === this.#level) return;
    this.#level = wanted;
    this.#isStale = false;
    void this.#rebuild(wanted, pxPerUnit);
  }

  #onPose(pose: Pose): void {
    this.newestMs = Date.now();
    if (pose.epoch !== this.#epoch) return;
    this.bands = pose.bands;
    this.#comes = pose.channels;
    this.#playout.setBandEnds(pose.bandEnds);
    this.#playout.add(pose.captureUs, BigInt(pose.arrivalUs), pose.coefficients, pose.bands, pose.kind === 'estimate');
    if (pose.next) this.#playout.addNext(pose.next.captureUs, pose.next.coefficients, pose.next.bands);
  }
  #onSurface(surface: Surface): void {
    if (surface.epoch !== this.#epoch) {
      // A sender that comes back with the same surface: what is shown stays until its first pose.
      const isSame = surface.asset === this.#asset;
      this.#epoch = surface.epoch;
      this.#asset = surface.asset;
      if (!isSame || !surface.continues) {
        this.#playout.reset();
        this.#shownUs = undefined;
      }
      if (!isSame) [this.#coefficients, this.box] = [undefined, undefined];
    }
    this.#surface = surface;
    this.#coefficients ??= surface.rest;
    if (this.#coefficients === surface.rest) this.#channels = 3;
    this.#isStale = true;
    if (!this.box || surface.isComplete) void this.#measure(surface);
    if (!this.#drawn) setTimeout(() => this.advance(nowUs(), Infinity));  // Of its pose, which is behind it; no turn is waited for.
    this.#changed(undefined);
  }
  #onStatus({ state }: Status): void {
    const isWell = state === 'live' || state === 'downloading';
    this.#lostSinceMs = isWell ? undefined : (this.#lostSinceMs ?? Date.now());
  }
  /** The box of the rest pose as rebuilt here: exact in every basis and for every part that has arrived. */
  async #measure(surface: Surface): Promise<void> {
    const rebuilt = await this.stream.rebuild({ coefficients: surface.rest, channels: 3 }).catch(() => undefined);
    if (!rebuilt || this.#isClosed || rebuilt.vertices === 0) return;
    const at = rebuilt.positions, most = DIRECTIONS.map(() => -Infinity);
    for (let i = 0; i < at.length; i += 3) {
      const point: Vec3 = [at[i]!, at[i + 1]!, at[i + 2]!];
      DIRECTIONS.forEach((direction, k) => {
        const far = dot(direction, point);
        if (far > most[k]!) [most[k], this.outline[k]] = [far, point];
      });
    }
    const along = (k: number): number => this.outline[k]![k === 12 || k === 13 ? 0 : k === 10 || k === 15 ? 1 : 2]!;
    this.box = [[along(12), along(10), along(4)], [along(13), along(15), along(21)]];
    this.#changed(undefined);
  }
  #choose(nowUs: number): boolean {
    if (this.isPaused && this.#shownUs !== undefined) return false;
    const pose = this.#playout.at(BigInt(nowUs));
    if (!pose) return false;
    this.shown = pose.shown;
    const isNew = pose.timeUs !== this.#shownUs;
    // Once more after settling, so that no error remains.
    if (!isNew && !pose.settling && !this.#isSettling) return false;
    this.#isSettling = pose.settling;
    this.#shownUs = pose.timeUs;
    if (isNew) ++this.posesShown;
    this.#coefficients = pose.coefficients.slice();
    this.#channels = this.#comes;
    return true;
  }
  async #rebuild(level: number, pxPerUnit: number): Promise<void> {
    const coefficients = this.#coefficients!, channels = this.#channels, surface = this.#surface!;
    let used = coefficients.length;
    while (used > 0 && coefficients[used - 1] === 0) --used;
    const spare = this.#spare, had = this.#version, painter = this.#painter;
    const numbers = painter?.of({ coefficients, channels, rest: surface.rest, timeUs: this.#shownUs, info: this.stream.info, live: this });
    this.#spare = undefined;
    this.#isInFlight = true;
    try {
      const rebuilt = await this.stream.rebuild({
        coefficients, channels, level, rank: Math.max(1, Math.ceil(used / channels)), trianglesVersion: had, isTextured: this.#isTextured, pxPerUnit, points: this.#points,
        numbers,
        ...(spare ? { room: { positions: spare.positions.buffer as ArrayBuffer, normals: spare.normals?.buffer as ArrayBuffer } } : {}),
      });
      if (this.#isClosed) return;
      // What the answer leaves out was forgotten meanwhile.
      if (!rebuilt.triangles && had !== this.#version) return void (this.#isStale = true);
      this.#version = rebuilt.trianglesVersion;
      this.#isStale ||= rebuilt.isMoving;
      this.#spare = this.#drawn?.rebuilt;
      if (rebuilt.range) painter?.include(rebuilt.range);
      this.#drawn = { rebuilt, isCloud: surface.facts.faceTotal === 0, area: surface.facts.area, numbered: numbers?.coefficients };
      this.#changed(this.#drawn);
    } catch (error) {
      if (!(error instanceof EigencastError)) throw error;  // Another surface is on its way.
    } finally {
      this.#isInFlight = false;
    }
  }
}
