// SPDX-License-Identifier: MIT
import { compiled } from '../client/client.js';
import { defaults } from '../client/defaults.js';
import { surroundings } from '../client/environment.js';
import { FULL, Levels, type LevelObject, type Quality } from '../core/levels.js';
import { Core, EigencastError } from '../core/module.js';
import { nowUs } from './clock.js';
import type { GL } from './gl.js';
import { Renderer } from './renderer.js';
import type { Tile } from './target.js';
import type { View } from './view.js';

/** Of pictures until one shows a surface, which is there in half the time. */
const QUICK: Readonly<Quality> = { resolution: 1, samples: 0, shadow: 1 };
const HIDDEN_AFTER_MS = 2000;
/** Until what holds the rate is asked for again. */
const RETRY_MS = 5000;
/** Of more surfaces so many are drawn in a turn of the display, all of them one after the other. */
const MAX_A_TURN = 20;
/** Up to so many are drawn as soon as they can be. */
const FEW = 4;
/** Times of the display's turn: one that takes longer was held up by what was drawn, not by a display that saves power. */
const LATE = 2.2;
/** Of the canvas that pictures are drawn to, where one of them is not wider. */
const MAX_SIDE = 2048;

export interface StageOptions {
  /** What detail and pixels are given up for (default: 60); 0: nothing is, however long pictures take. */
  picturesPerSecond?: number;
}

/** What is to be drawn for a canvas. */
export interface Picture {
  to: CanvasRenderingContext2D;
  paint(renderer: Renderer, tile: Tile): void;
}

/**
 * What the pictures of a page share: one GL context, for browsers give few; the display's turns; and the levels of
 * detail, so that all of them together are in time.
 */
export class Stage {
  readonly core: Core;
  readonly #canvas: HTMLCanvasElement;
  readonly #gl: GL;
  readonly #rate: number;
  #levels: Levels | undefined;
  #isControlled = false;
  #isClosed = false;
  readonly #views = new Set<View>();
  readonly #changed = new Set<View>();
  readonly #seen: IntersectionObserver;
  #renderer: Renderer | undefined;
  #turn: number | undefined;
  #hidden: ReturnType<typeof setTimeout> | undefined;
  #turnedMs = 0;
  #next = 0;
  /** Of the pictures that are drawn: when their work began, and how long it takes. */
  #beganMs = 0;
  #workMs = 0;
  /** Of several, until the last one's surface was there, beside the drawing of those before. */
  #rebuiltMs = 0;
  #lastWorkMs = 0;
  #isLate = false;
  /** Between the display's turns, at least. */
  #leastTurnMs = Infinity;
  #lastTurnMs = 0;
  #fence: WebGLSync | undefined;

  private constructor(core: Core, canvas: HTMLCanvasElement, gl: GL, renderer: Renderer, picturesPerSecond: number) {
    this.core = core;
    this.#canvas = canvas;
    this.#gl = gl;
    this.#rate = picturesPerSecond;
    this.#use(renderer);
    this.#seen = new IntersectionObserver((entries) => {
      for (const { target, isIntersecting } of entries) for (const view of this.#views) if (view.canvas === target) view.isInSight = isIntersecting;
    });
    canvas.addEventListener('webglcontextlost', (event) => {
      event.preventDefault();  // It may come back.
      this.#renderer = this.#fence = undefined;
    });
    canvas.addEventListener('webglcontextrestored', () => {
      this.#use(new Renderer(gl));
      for (const view of this.#views) view.forgetSurface();
    });
    document.addEventListener('visibilitychange', this.#onVisibility);
  }
  /** `module`: the core, as the broker's, which may be on its way. Throws EigencastError (unsupported) without WebGL 2. */
  static async make(module: WebAssembly.Module | Promise<WebAssembly.Module>, { picturesPerSecond = 60 }: StageOptions = {}): Promise<Stage> {
    const canvas = document.createElement('canvas');
    const gl = canvas.getContext('webgl2', { alpha: true, antialias: false, depth: false, powerPreference: 'high-performance' });
    if (!gl) {
      throw new EigencastError('unsupported', 'this browser draws no WebGL 2: turn hardware acceleration on in its settings, or open the page in another browser');
    }
    const renderer = new Renderer(gl);  // Shaders are compiled while the core arrives.
    return new Stage(await Core.make(await module), canvas, gl, renderer, picturesPerSecond);
  }
  close(): void {
    for (const view of [...this.#views]) view.close();
    document.removeEventListener('visibilitychange', this.#onVisibility);
    this.#seen.disconnect();
    this.#isClosed = true;
    this.#levels?.free();
    this.#gl.getExtension('WEBGL_lose_context')?.loseContext();
  }

  #use(renderer: Renderer): void {
    this.#renderer = renderer;
    renderer.onLoaded = () => this.#views.forEach((view) => view.invalidate());
  }
  /** Nothing while the context is lost. */
  get renderer(): Renderer | undefined {
    return this.#renderer;
  }
  get gl(): GL {
    return this.#gl;
  }
  /** The planned work of a picture, as a part of a display's turn. */
  get load(): number {
    return this.#levels?.state ?? 0;
  }
  /** How pictures are drawn: with fewer pixels than the display's, and less, where all is too much for the GPU. */
  get quality(): Readonly<Quality> {
    return this.#levels?.quality ?? (this.#rate > 0 && !this.#isControlled ? QUICK : FULL);
  }
  /** What the last picture took. */
  get workMs(): number {
    return this.#lastWorkMs;
  }
  add(view: View): void {
    this.#views.add(view);
    this.#seen.observe(view.canvas);
    this.#schedule();
  }
  remove(view: View): void {
    this.#views.delete(view);
    this.#changed.delete(view);
    this.#seen.unobserve(view.canvas);
  }

  /** A view has something else to show: at once, or, of several, with the others in the display's next turn. */
  show(view: View): void {
    this.#changed.add(view);
    if (this.#views.size <= FEW) this.#drawChanged();
    else this.#rebuiltMs = performance.now() - this.#turnedMs;
  }
  /** Draws pictures side by side, and copies each to its own canvas: copying from a GL canvas waits for all of its drawing. */
  draw(pictures: readonly Picture[]): void {
    const canvas = this.#canvas, renderer = this.#renderer, tiles: [Picture, Tile][] = [];
    if (!renderer) return;
    let x = 0, y = 0, upper = 0, right = 0;
    for (const picture of pictures) {
      const { width, height } = picture.to.canvas;
      if (width < 1 || height < 1) continue;
      if (x + width > MAX_SIDE) [x, y] = [0, upper];
      tiles.push([picture, { x, y, width, height }]);
      [x, upper] = [x + width, Math.max(upper, y + height)];
      right = Math.max(right, x);
    }
    if (canvas.width < right) canvas.width = right;
    if (canvas.height < upper) canvas.height = upper;
    this.#beganMs = this.#views.size <= FEW ? this.#turnedMs : performance.now();
    for (const [picture, tile] of tiles) picture.paint(renderer, tile);
    for (const [{ to }, tile] of tiles) {
      to.globalCompositeOperation = 'copy';
      to.drawImage(canvas, tile.x, canvas.height - tile.y - tile.height, tile.width, tile.height, 0, 0, tile.width, tile.height);
    }
    this.#workMs = this.#lastWorkMs = performance.now() - this.#beganMs;
    this.#fence ??= this.#gl.fenceSync(this.#gl.SYNC_GPU_COMMANDS_COMPLETE, 0) ?? undefined;
    this.#gl.flush();  // Else they wait for the display's next turn.
  }

  /** Behind the first picture of a surface; until it is there all is drawn. What fails is said later: nothing loads on a page that is being left. */
  #control(): void {
    this.#isControlled = true;
    void compiled(defaults.levels, surroundings()).then((module) => Core.make(module)).then((core) => {
      if (!this.#isClosed) this.#levels = new Levels(core, this.#rate);
    }).catch((error: unknown) => setTimeout(() => {
      console.error('eigencast: pictures may be late, for what holds their rate was not loaded; it is asked for again:', error);
      if (!this.#isClosed) this.#control();
    }, RETRY_MS));
  }
  #schedule(): void {
    this.#turn ??= requestAnimationFrame((displayedMs) => {
      this.#turn = undefined;
      if (this.#views.size > 0) this.#schedule();
      if (displayedMs > this.#lastTurnMs) this.#leastTurnMs = Math.min(this.#leastTurnMs, displayedMs - this.#lastTurnMs);
      this.#lastTurnMs = displayedMs;
      this.#advance();
    });
  }
  #advance(): void {
    if (this.#isGpuBusy()) return;
    const workMs = Math.max(this.#workMs, this.#rebuiltMs);
    this.#workMs = this.#rebuiltMs = 0;
    this.#drawChanged();
    const views = this.#due([...this.#views].filter((view) => view.isInSight));
    const objects: LevelObject[] = [];
    for (const view of views) {
      view.prepare();
      const object = view.levelObject();
      if (object) objects.push(object);
    }
    if (this.#rate > 0 && !this.#isControlled && views.some((view) => view.vertices > 0)) this.#control();
    const now = nowUs();
    const levels = this.#levels?.resolve(objects, BigInt(now), workMs / 1000);
    this.#turnedMs = performance.now();
    let next = 0;
    for (const view of views) view.advance(now, levels && view.levelObject() ? levels[next++]! : view.maxVertices);
  }
  #drawChanged(): void {
    if (!this.#renderer?.isMade) return;
    const views = [...this.#changed];
    this.#changed.clear();
    if (views.length > 0) this.draw(views.map((view) => view.nextPicture()));
  }
  #due(views: View[]): View[] {
    if (!(this.#rate > 0) || views.length <= MAX_A_TURN) return views;
    const from = this.#next % views.length;
    this.#next = from + MAX_A_TURN;
    return [...views, ...views].slice(from, from + MAX_A_TURN);
  }
  /** Until what was drawn is done, nothing more is asked of a GPU that is late; how late is the picture's work. */
  #isGpuBusy(): boolean {
    const gl = this.#gl;
    if (!this.#fence) return false;
    gl.flush();
    // Work that is over is seen at a turn only, and a GPU that is late holds the turns up as well.
    const elapsedMs = performance.now() - this.#beganMs;
    if (this.#isLate || elapsedMs > LATE * this.#leastTurnMs) this.#workMs = this.#lastWorkMs = Math.max(this.#workMs, elapsedMs);
    if (gl.getSyncParameter(this.#fence, gl.SYNC_STATUS) === gl.SIGNALED || gl.isContextLost()) {
      gl.deleteSync(this.#fence);
      this.#fence = undefined;
      return (this.#isLate = false);
    }
    return (this.#isLate = true);
  }
  /** A page that nobody sees takes no poses. */
  readonly #onVisibility = (): void => {
    clearTimeout(this.#hidden);
    if (!document.hidden) for (const view of this.#views) view.isHidden = false;
    else this.#hidden = setTimeout(() => {
      for (const view of this.#views) view.isHidden = true;
    }, HIDDEN_AFTER_MS);
  };
}
