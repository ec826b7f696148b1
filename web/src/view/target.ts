// SPDX-License-Identifier: MIT
import type { GL } from './gl.js';

/** A part of the canvas, pixels from its lower left. */
export interface Tile {
  x: number;
  y: number;
  width: number;
  height: number;
}

/** Where a picture is drawn; what is drawn is copied from here. */
export class Target {
  readonly #gl: GL;
  readonly #sampled: WebGLFramebuffer;
  readonly #buffers: WebGLRenderbuffer[];
  width = 0;
  height = 0;
  #samples = 0;

  constructor(gl: GL) {
    this.#gl = gl;
    this.#sampled = gl.createFramebuffer();
    this.#buffers = [gl.createRenderbuffer(), gl.createRenderbuffer()];
  }

  /** Grows to hold the tile, and makes it what is drawn to; samples: a pixel, 0: one. */
  bind(tile: Tile, samples: number): void {
    const gl = this.#gl, width = tile.x + tile.width, height = tile.y + tile.height;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.#sampled);
    if (width <= this.width && height <= this.height && samples === this.#samples) return;
    this.#samples = samples;
    this.width = Math.max(width, this.width);
    this.height = Math.max(height, this.height);
    const most = gl.getParameter(gl.MAX_SAMPLES) as number;  // Asking waits for the GPU.
    [[gl.RGBA8, gl.COLOR_ATTACHMENT0], [gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT]].forEach(([format, attachment], i) => {
      gl.bindRenderbuffer(gl.RENDERBUFFER, this.#buffers[i]!);
      gl.renderbufferStorageMultisample(gl.RENDERBUFFER, Math.min(samples, most), format!, this.width, this.height);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, attachment!, gl.RENDERBUFFER, this.#buffers[i]!);
    });
  }
  /** To the canvas, which stays bound. */
  present(tile: Tile): void {
    this.copyTo(null, tile, this.#gl.COLOR_BUFFER_BIT);
  }
  /** At the same place of another one, which stays bound; null: of the canvas. */
  copyTo(to: WebGLFramebuffer | null, { x, y, width, height }: Tile, what: number): void {
    const gl = this.#gl, right = x + width, upper = y + height;  // Samples are resolved in place only.
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, this.#sampled);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, to);
    gl.blitFramebuffer(x, y, right, upper, x, y, right, upper, what, gl.NEAREST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, to);
  }
}
