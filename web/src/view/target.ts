// SPDX-License-Identifier: MIT
import { bindTexture, setFilter, type GL } from './gl.js';

const SAMPLES = 4;

/** A part of the canvas, pixels from its lower left. */
export interface Tile {
  x: number;
  y: number;
  width: number;
  height: number;
}

/** Where a picture is drawn, several samples a pixel; what is drawn is copied to the canvas, or read as textures. */
export class Target {
  readonly #gl: GL;
  readonly #sampled: WebGLFramebuffer;
  readonly #resolved: WebGLFramebuffer;
  readonly #buffers: WebGLRenderbuffer[];
  readonly colour: WebGLTexture;
  readonly depth: WebGLTexture;
  #width = 0;
  #height = 0;
  #hasTextures = false;

  constructor(gl: GL) {
    this.#gl = gl;
    this.#sampled = gl.createFramebuffer();
    this.#resolved = gl.createFramebuffer();
    this.#buffers = [gl.createRenderbuffer(), gl.createRenderbuffer()];
    this.colour = gl.createTexture();
    this.depth = gl.createTexture();
  }

  /** Grows to hold the tile, and makes it what is drawn to. */
  bind(tile: Tile): void {
    const gl = this.#gl, width = tile.x + tile.width, height = tile.y + tile.height;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.#sampled);
    if (width <= this.#width && height <= this.#height) return;
    this.#width = Math.max(width, this.#width);
    this.#height = Math.max(height, this.#height);
    this.#hasTextures = false;
    const samples = Math.min(SAMPLES, gl.getParameter(gl.MAX_SAMPLES) as number);  // Asking waits for the GPU.
    [[gl.RGBA8, gl.COLOR_ATTACHMENT0], [gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT]].forEach(([format, attachment], i) => {
      gl.bindRenderbuffer(gl.RENDERBUFFER, this.#buffers[i]!);
      gl.renderbufferStorageMultisample(gl.RENDERBUFFER, samples, format!, this.#width, this.#height);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, attachment!, gl.RENDERBUFFER, this.#buffers[i]!);
    });
  }
  /** To the canvas, which stays bound. */
  present(tile: Tile): void {
    this.#copy(null, tile, this.#gl.COLOR_BUFFER_BIT);
  }
  /** To `colour` and `depth`; the canvas stays bound. */
  resolve(tile: Tile): void {
    const gl = this.#gl;
    if (!this.#hasTextures) this.#makeTextures();
    this.#copy(this.#resolved, tile, gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  #copy(to: WebGLFramebuffer | null, { x, y, width, height }: Tile, what: number): void {
    const gl = this.#gl, right = x + width, upper = y + height;  // Samples are resolved in place only.
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, this.#sampled);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, to);
    gl.blitFramebuffer(x, y, right, upper, x, y, right, upper, what, gl.NEAREST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, to);
  }
  #makeTextures(): void {
    const gl = this.#gl;
    this.#hasTextures = true;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.#resolved);
    const make = (texture: WebGLTexture, attachment: number, inside: number, format: number, type: number): void => {
      bindTexture(gl, 0, texture);
      gl.texImage2D(gl.TEXTURE_2D, 0, inside, this.#width, this.#height, 0, format, type, null);
      setFilter(gl, gl.NEAREST);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, attachment, gl.TEXTURE_2D, texture, 0);
    };
    make(this.colour, gl.COLOR_ATTACHMENT0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE);
    make(this.depth, gl.DEPTH_ATTACHMENT, gl.DEPTH_COMPONENT24, gl.DEPTH_COMPONENT, gl.UNSIGNED_INT);
  }
}
