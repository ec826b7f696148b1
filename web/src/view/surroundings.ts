// SPDX-License-Identifier: MIT
import { kBackgroundFragment, kGroundFragment, kGroundVertex, kLighting, kLineFragment, kMeshVertex, kScreenVertex } from '../../../view/shaders.h';
import type { Camera } from './camera.js';
import { Program, type GL } from './gl.js';
import { NO_SHADOW, type Lighting } from './lighting.js';
import { cross, difference, dot, IDENTITY, length, product, sum, times, type Vec3 } from './matrix.js';
import type { Tile } from './target.js';

/** The wall, the floor with the surfaces' shadows, and the scene's axes: view/surroundings.h. */
export class Surroundings {
  readonly #gl: GL;
  readonly #wall: Program;
  readonly #floor: Program;
  readonly #line: Program;
  readonly #none: WebGLVertexArrayObject;
  readonly #axes: WebGLVertexArrayObject;
  readonly #ends: WebGLBuffer;

  constructor(gl: GL) {
    this.#gl = gl;
    this.#wall = new Program(gl, 'wall', kScreenVertex, kBackgroundFragment);
    this.#floor = new Program(gl, 'floor', kGroundVertex, kLighting + kGroundFragment);
    this.#line = new Program(gl, 'axes', kMeshVertex, kLineFragment);
    this.#wall.start();
    this.#floor.start();
    this.#none = gl.createVertexArray();
    this.#axes = gl.createVertexArray();
    this.#ends = gl.createBuffer();
    gl.bindVertexArray(this.#axes);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.#ends);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.enableVertexAttribArray(0);
  }

  get isMade(): boolean {
    return this.#wall.isMade && this.#floor.isMade;
  }
  drawWall(): void {
    const gl = this.#gl;
    gl.disable(gl.DEPTH_TEST);
    this.#wall.use();
    gl.bindVertexArray(this.#none);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
  /** `hasShadow`: where surfaces touch it. The shadow map is bound; what is seen of the tile is scissored. */
  drawFloor(camera: Camera, lighting: Lighting, hasGrid: boolean, hasShadow: boolean, pixelScale: number, tile: Tile, seen: Tile): void {
    const gl = this.#gl, up = camera.upVector, { radius, centre } = camera;
    const level = dot(camera.low, up) - 0.02 * radius;
    if (dot(camera.position, up) <= level) return;  // Seen from below it would hide the surface.
    const a: Vec3 = [up[1], up[2], up[0]], b = cross(up, a), extent = difference(camera.high, camera.low);
    const reach = 4 * radius, across = Math.max(length(difference(extent, times(dot(extent, up), up))), 0.2 * radius);
    lighting.light(this.#floor, camera);
    this.#floor.set({
      ground_centre: sum(centre, times(level - dot(centre, up), up)), ground_a: times(reach, a), ground_b: times(reach, b),
      grid_cells: 20, grid_strength: hasGrid ? 1 : 0, pixel_scale: pixelScale, contact_radius: hasShadow ? (0.5 * across) / reach : 1e-4,
    });
    gl.enable(gl.BLEND);
    gl.depthMask(false);
    gl.bindVertexArray(this.#none);
    // The shadow takes nearly all of the floor's time: it is looked up where it may be.
    const dark = lighting.shadowOn(camera, level, tile), right = dark.x + dark.width, upper = dark.y + dark.height, endX = seen.x + seen.width, endY = seen.y + seen.height;
    const draw = (saving: number, x0: number, y0: number, x1: number, y1: number): void => {
      const x = Math.min(x1, endX) - x0, y = Math.min(y1, endY) - y0;
      if (x <= 0 || y <= 0) return;
      this.#floor.set({ shadow_saving: saving });
      gl.scissor(x0, y0, x, y);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    };
    draw(lighting.saving, dark.x, dark.y, right, upper);
    draw(NO_SHADOW, seen.x, seen.y, endX, dark.y);
    draw(NO_SHADOW, seen.x, upper, endX, endY);
    draw(NO_SHADOW, seen.x, dark.y, dark.x, upper);
    draw(NO_SHADOW, right, dark.y, endX, upper);
    gl.scissor(seen.x, seen.y, seen.width, seen.height);
    gl.depthMask(true);
    gl.disable(gl.BLEND);
  }
  drawAxes(camera: Camera): void {
    const gl = this.#gl, from = camera.centre;
    this.#line.use().set({ clip_from_scene: product(camera.clipFromView, camera.viewFromScene), scene_from_surface: IDENTITY });
    gl.bindVertexArray(this.#axes);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.#ends);
    gl.disable(gl.DEPTH_TEST);
    for (const axis of [0, 1, 2]) {
      const to = from.map((at, i) => at + (i === axis ? 1.15 * camera.radius : 0));
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([...from, ...to]), gl.STREAM_DRAW);
      this.#line.set({ line_colour: [0, 1, 2, 3].map((i) => (i === 3 ? 1 : i === axis ? 0.8 : 0.15)) });
      gl.drawArrays(gl.LINES, 0, 2);
    }
    gl.enable(gl.DEPTH_TEST);
  }
}
