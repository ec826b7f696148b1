// SPDX-License-Identifier: MIT
import { kShadowFragment, kShadowVertex } from '../../../view/shaders.h';
import type { Camera } from './camera.js';
import { bindTexture, Program, setFilter, type GL } from './gl.js';
import type { GlSurface } from './gl_surface.js';
import { cross, difference, dot, IDENTITY, lookAt, orthographic, product, sum, times, unit, type Mat4, type Vec3 } from './matrix.js';

const SHADOW_SIDE = 512;
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

  constructor(gl: GL) {
    this.#gl = gl;
    this.#shadow = new Program(gl, 'shadow', kShadowVertex, kShadowFragment);
    this.#shadow.start();
    this.#map = gl.createTexture();
    bindTexture(gl, 0, this.#map);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.DEPTH_COMPONENT24, SHADOW_SIDE, SHADOW_SIDE);
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
  /** Puts the lights beside the camera and draws the shadow map. */
  cast(camera: Camera, surfaces: readonly GlSurface[]): void {
    const gl = this.#gl, up = camera.upVector;
    this.#key = beside(camera, -0.62, 1.15, 0.62);
    this.#fill = beside(camera, 0.9, 0.15, 0.45);
    const reach = 2.2 * camera.radius;  // A deforming surface leaves its rest box.
    const other: Vec3 = Math.abs(dot(this.#key, up)) > 0.99 ? [up[1], up[2], up[0]] : up;
    this.#lightFromScene = product(
      orthographic(reach, 4 * reach), lookAt(sum(camera.centre, times(2 * reach, this.#key)), camera.centre, other));
    if (surfaces.length === 0 && this.#isEmpty) return;
    this.#isEmpty = surfaces.length === 0;
    bindTexture(gl, 0, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.#framebuffer);
    gl.viewport(0, 0, SHADOW_SIDE, SHADOW_SIDE);
    gl.depthMask(true);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    this.#shadow.use().set({ light_from_scene: this.#lightFromScene });
    for (const surface of surfaces) {
      surface.bind(this.#shadow);
      this.#shadow.set({ point_px: Math.max(1, (surface.spacing * SHADOW_SIDE) / reach) });
      if (surface.isCloud) surface.drawPoints();
      else surface.drawTriangles();
    }
  }
  /** The map is texture 0 from now on. */
  bind(): void {
    bindTexture(this.#gl, 0, this.#map);
  }
  /** Uses a program of kLighting. */
  light(program: Program, camera: Camera): void {
    program.use().set({
      shadow_map: 0, light_from_scene: this.#lightFromScene, clip_from_scene: product(camera.clipFromView, camera.viewFromScene),
      eye: camera.position, up: camera.upVector, key_light: this.#key, fill_light: this.#fill, albedo: CLAY, albedo_inside: CLAY_INSIDE,
      normal_offset: 0.018 * camera.radius,
    });
  }
}

function beside(camera: Camera, right: number, above: number, behind: number): Vec3 {
  const up = camera.upVector, back = unit(difference(camera.position, camera.target)), side = unit(cross(up, back));
  return unit(sum(sum(times(right, side), times(above, up)), times(behind, cross(side, up))));
}
