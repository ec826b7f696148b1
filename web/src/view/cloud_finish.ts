// SPDX-License-Identifier: MIT
import { kFinishFragment, kScreenVertex } from '../../../view/shaders.h?alone';
import type { Camera } from './camera.js';
import type * as Tools from './gl.js';
import type { Target, Tile } from './target.js';

/** Depth shading. */
const DOME = 90;

type GL = Tools.GL;
/** What the page has loaded. */
type Loaded = Pick<typeof Tools, 'Program' | 'bindTexture' | 'setFilter'>;

/** The last step of pictures of clouds without discs, which little else needs: loaded by what draws one. */
export class CloudFinish {
  readonly #gl: GL;
  readonly #loaded: Loaded;
  readonly #program: Tools.Program;
  readonly #resolved: WebGLFramebuffer;
  readonly #colour: WebGLTexture;
  readonly #depth: WebGLTexture;
  readonly #none: WebGLVertexArrayObject;
  #width = 0;
  #height = 0;

  constructor(gl: GL, loaded: Loaded) {
    this.#gl = gl;
    this.#loaded = loaded;
    this.#program = new loaded.Program(gl, 'finish', kScreenVertex, kFinishFragment);
    this.#resolved = gl.createFramebuffer();
    this.#colour = gl.createTexture();
    this.#depth = gl.createTexture();
    this.#none = gl.createVertexArray();
  }
  /** What the target holds, to the canvas; binds textures 0 and 1. */
  draw(target: Target, camera: Camera, tile: Tile): void {
    const gl = this.#gl, { bindTexture } = this.#loaded;
    if (target.width !== this.#width || target.height !== this.#height) this.#makeTextures(target);
    target.copyTo(this.#resolved, tile, gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.disable(gl.DEPTH_TEST);
    // The shader gives straight colours.
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ZERO, gl.ONE, gl.ZERO);
    this.#program.use().set({ picture: 0, depth: 1, dome: DOME, near_far: camera.nearFar });
    bindTexture(gl, 0, this.#colour);
    bindTexture(gl, 1, this.#depth);
    gl.bindVertexArray(this.#none);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.disable(gl.BLEND);
  }
  #makeTextures({ width, height }: Target): void {
    const gl = this.#gl, { bindTexture, setFilter } = this.#loaded;
    [this.#width, this.#height] = [width, height];
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.#resolved);
    const make = (texture: WebGLTexture, attachment: number, inside: number, format: number, type: number): void => {
      bindTexture(gl, 0, texture);
      gl.texImage2D(gl.TEXTURE_2D, 0, inside, width, height, 0, format, type, null);
      setFilter(gl, gl.NEAREST);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, attachment, gl.TEXTURE_2D, texture, 0);
    };
    make(this.#colour, gl.COLOR_ATTACHMENT0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE);
    make(this.#depth, gl.DEPTH_ATTACHMENT, gl.DEPTH_COMPONENT24, gl.DEPTH_COMPONENT, gl.UNSIGNED_INT);
  }
}
