// SPDX-License-Identifier: MIT
import { Levels, type LevelObject } from '../core/levels.js';
import { Core, EigencastError } from '../core/module.js';
import type { GL } from './gl.js';
import { Renderer } from './renderer.js';
import { Sharpness } from './sharpness.js';
import type { View } from './view.js';

const HIDDEN_AFTER_MS = 2000;

export interface StageOptions {
  /** What detail and pixels are given up for (default: 60); 0: nothing is, however long pictures take. */
  picturesPerSecond?: number;
}

/** Microseconds on the clock that the worker shares. */
export const nowUs = (): number => Math.round((performance.timeOrigin + performance.now()) * 1000);

/**
 * What the pictures of a page share: one GL context, for browsers give few; the display's turns; and the levels of
 * detail, so that all of them together are in time.
 */
export class Stage {
  readonly core: Core;
  readonly #canvas: HTMLCanvasElement;
  readonly #gl: GL;
  readonly #levels: Levels | undefined;
  readonly #turnMs: number;
  readonly #views = new Set<View>();
  readonly #sharpness = new Sharpness();
  readonly #seen: IntersectionObserver;
  #renderer: Renderer | undefined;
  #turn: number | undefined;
  #hidden: ReturnType<typeof setTimeout> | undefined;
  #turnedMs = 0;
  #workMs = 0;
  #lastWorkMs = 0;
  #fence: WebGLSync | undefined;

  private constructor(core: Core, canvas: HTMLCanvasElement, gl: GL, picturesPerSecond: number) {
    this.core = core;
    this.#canvas = canvas;
    this.#gl = gl;
    this.#levels = picturesPerSecond > 0 ? new Levels(core, picturesPerSecond) : undefined;
    this.#turnMs = 1000 / picturesPerSecond;
    this.#renderer = new Renderer(gl);
    this.#seen = new IntersectionObserver((entries) => {
      for (const { target, isIntersecting } of entries) for (const view of this.#views) if (view.canvas === target) view.isInSight = isIntersecting;
    });
    canvas.addEventListener('webglcontextlost', (event) => {
      event.preventDefault();  // It may come back.
      this.#renderer = this.#fence = undefined;
    });
    canvas.addEventListener('webglcontextrestored', () => {
      this.#renderer = new Renderer(gl);
      for (const view of this.#views) view.forgetSurface();
    });
    document.addEventListener('visibilitychange', this.#onVisibility);
  }
  /** `module`: the core, as the broker's. Throws EigencastError (unsupported) without WebGL 2. */
  static async make(module: WebAssembly.Module, { picturesPerSecond = 60 }: StageOptions = {}): Promise<Stage> {
    const canvas = document.createElement('canvas');
    const gl = canvas.getContext('webgl2', { alpha: true, antialias: false, depth: false, powerPreference: 'high-performance' });
    if (!gl) {
      throw new EigencastError('unsupported', 'this browser draws no WebGL 2: turn hardware acceleration on in its settings, or open the page in another browser');
    }
    return new Stage(await Core.make(module), canvas, gl, picturesPerSecond);
  }
  close(): void {
    for (const view of [...this.#views]) view.close();
    document.removeEventListener('visibilitychange', this.#onVisibility);
    this.#seen.disconnect();
    this.#levels?.free();
    this.#gl.getExtension('WEBGL_lose_context')?.loseContext();
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
  /** Pixels of the display that a picture has, along each side: fewer where they are too many for the GPU. */
  get sharpness(): number {
    return this.#sharpness.value;
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
    this.#seen.unobserve(view.canvas);
  }

  /** Draws by `paint` into a canvas that is that large, and copies it to `to`. */
  draw(to: CanvasRenderingContext2D, width: number, height: number, paint: (renderer: Renderer) => void): void {
    const canvas = this.#canvas;
    if (!this.#renderer || width < 1 || height < 1) return;
    if (canvas.width < width) canvas.width = width;
    if (canvas.height < height) canvas.height = height;
    paint(this.#renderer);
    to.globalCompositeOperation = 'copy';
    to.drawImage(canvas, 0, canvas.height - height, width, height, 0, 0, width, height);
    this.#workMs = this.#lastWorkMs = performance.now() - this.#turnedMs;
    this.#fence ??= this.#gl.fenceSync(this.#gl.SYNC_GPU_COMMANDS_COMPLETE, 0) ?? undefined;
  }

  #schedule(): void {
    this.#turn ??= requestAnimationFrame(() => {
      this.#turn = undefined;
      if (this.#views.size > 0) this.#schedule();
      this.#advance();
    });
  }
  #advance(): void {
    if (this.#isGpuBusy()) return;
    const views = [...this.#views].filter((view) => view.isInSight);
    const objects: LevelObject[] = [];
    for (const view of views) {
      view.prepare();
      const object = view.levelObject();
      if (object) objects.push(object);
    }
    if (this.#workMs > 0) this.#sharpness.add(this.#workMs, this.#turnMs);
    const now = nowUs();
    const levels = this.#levels?.resolve(objects, BigInt(now), this.#workMs / 1000);
    this.#workMs = 0;
    this.#turnedMs = performance.now();
    let next = 0;
    for (const view of views) view.advance(now, levels && view.levelObject() ? levels[next++]! : view.maxVertices);
  }
  /** Until what was drawn is done, nothing more is asked of a GPU that is late; how late is the picture's work. */
  #isGpuBusy(): boolean {
    const gl = this.#gl;
    if (!this.#fence) return false;
    gl.flush();
    if (gl.getSyncParameter(this.#fence, gl.SYNC_STATUS) === gl.SIGNALED || gl.isContextLost()) {
      gl.deleteSync(this.#fence);
      this.#fence = undefined;
      return false;
    }
    this.#workMs = this.#lastWorkMs = Math.max(this.#workMs, performance.now() - this.#turnedMs);
    return true;
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
