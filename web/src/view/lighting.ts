// SPDX-License-Identifier: MIT
import { kShadowFragment, kShadowVertex } from '../../../view/shaders.h';
import type { Camera } from './camera.js';
import { bindTexture, Program, setFilter, type GL } from './gl.js';
import type { GlSurface } from './gl_surface.js';
import { cross, difference, dot, IDENTITY, lookAt, moved, orthographic, product, sum, times, unit, type Mat4, type Vec3 } from './matrix.js';
import type { Tile } from './target.js';

const SIDES = [512, 256];
/** In place of Quality.shadow. */
export const NO_SHADOW = 2;
const REACH = 2.2;  // Of the shadow map, in radii: a deforming surface leaves its rest box.
const BLUR = 10 / 512;  // Of that: how far its shadow's edge may be from a surface's, and more.
const CLAY: Vec3 = [0.7, 0.185, 0.115], CLAY_INSIDE: Vec3 = [0.34, 0.21, 0.18];

/** Two lights that follow the camera, and the shadow of the first: view/surroundings.h. */
export class Lighting {
  readonly #gl: GL;
  readonly #shadow: Program;
  readonly #map: WebGLTexture;
  readonly #framebuffer: WebGLFramebuffer;
  #key: Vec3 = [0, 1, 0];
  #fill: Vec3 = [0, 0, 1];
  #lightFromScene: Mat4 = IDENTITY;
  #isEmpty = false;
  #side = 0;
  saving = 0;
  #casters: readonly GlSurface[] = [];

  constructor(gl: GL) {
    this.#gl = gl;
    this.#shadow = new Program(gl, 'shadow', kShadowVertex, kShadowFragment);
    this.#shadow.start();
    this.#map = gl.createTexture();
    bindTexture(gl, 0, this.#map);
    setFilter(gl, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE);
    this.#framebuffer = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.#framebuffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, this.#map, 0);
    gl.drawBuffers([gl.NONE]);
    gl.readBuffer(gl.NONE);
  }

  get isMade(): boolean {
    return this.#shadow.isMade;
  }
  /** Puts the lights beside the camera and draws the shadow map; saving: Quality.shadow. */
  cast(camera: Camera, surfaces: readonly GlSurface[], saving: number): void {
    const gl = this.#gl, up = camera.upVector;
    this.#key = beside(camera, -0.62, 1.15, 0.62);
    this.#fill = beside(camera, 0.9, 0.15, 0.45);
    const reach = REACH * camera.radius;
    const other: Vec3 = Math.abs(dot(this.#key, up)) > 0.99 ? [up[1], up[2], up[0]] : up;
    this.#lightFromScene = product(
      orthographic(reach, 4 * reach), lookAt(sum(camera.centre, times(2 * reach, this.#key)), camera.centre, other));
    this.saving = saving;
    this.#casters = surfaces;
    const side = SIDES[saving];
    if (side === undefined || (surfaces.length === 0 && this.#isEmpty && side === this.#side)) return;
    this.#isEmpty = surfaces.length === 0;
    if (side !== this.#side) {
      bindTexture(gl, 0, this.#map);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.DEPTH_COMPONENT24, side, side, 0, gl.DEPTH_COMPONENT, gl.UNSIGNED_INT, null);
      this.#side = side;
    }
    bindTexture(gl, 0, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.#framebuffer);
    gl.viewport(0, 0, side, side);
    gl.depthMask(true);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    this.#shadow.use().set({ light_from_scene: this.#lightFromScene });
    for (const surface of surfaces) {
      surface.bind(this.#shadow);
      this.#shadow.set({ point_px: Math.max(1, (surface.spacing * side) / reach) });
      if (surface.isCloud) surface.drawPoints();
      else surface.drawTriangles();
    }
  }
  /** What of a tile may be in shadow on a floor that is so high along `up`. */
  shadowOn(camera: Camera, level: number, { x, y, width, height }: Tile): Tile {
    const up = camera.upVector, side: Vec3 = [up[1], up[2], up[0]], other = cross(up, side), fall = dot(this.#key, up), pixels: [number, number][] = [];
    for (const surface of this.saving === NO_SHADOW ? [] : this.#casters) {
      const blur = (BLUR * REACH * camera.radius + (surface.isCloud ? surface.spacing : 0)) / fall;
      for (const corner of surface.corners) {
        const below = sum(corner, times((level - dot(corner, up)) / fall, this.#key));
        for (const [a, b] of [[blur, blur], [blur, -blur], [-blur, blur], [-blur, -blur]] as const) {
          const [right, above, back] = moved(camera.viewFromScene, sum(below, sum(times(a, side), times(b, other))));
          if (!(fall > 0.05 && back < -1e-6)) return { x, y, width, height };
          pixels.push([(0.5 - (0.5 * camera.clipFromView[0]! * right) / back) * width, (0.5 - (0.5 * camera.clipFromView[5]! * above) / back) * height]);
        }
      }
    }
    const span = (axis: 0 | 1, size: number): [number, number] => {
      const all = pixels.map((pixel) => pixel[axis]), from = Math.min(Math.max(Math.floor(Math.min(...all)) - 1, 0), size);
      return [from, Math.max(Math.min(Math.ceil(Math.max(...all)) + 1, size) - from, 0)];
    };
    const [left, across] = span(0, width), [lower, along] = span(1, height);
    return { x: x + left, y: y + lower, width: across, height: along };
  }
  /** The map is texture 0 from now on. */
  bind(): void {
    bindTexture(this.#gl, 0, this.#map);
  }
  /** Uses a program of kLighting. */
  light(program: Program, camera: Camera): void {
    program.use().set({
      shadow_map: 0, shadow_saving: this.saving, light_from_scene: this.#lightFromScene, clip_from_scene: product(camera.clipFromView, camera.viewFromScene),
      eye: camera.position, up: camera.upVector, key_light: this.#key, fill_light: this.#fill, albedo: CLAY, albedo_inside: CLAY_INSIDE,
      normal_offset: 0.018 * camera.radius,
    });
  }
}

function beside(camera: Camera, right: number, above: number, behind: number): Vec3 {
  const up = camera.upVector, back = unit(difference(camera.position, camera.target)), side = unit(cross(up, back));
  return unit(sum(sum(times(right, side), times(above, up)), times(behind, cross(side, up))));
}
