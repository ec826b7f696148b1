// SPDX-License-Identifier: MIT
import {
  kLighting, kLineFragment, kMeshFragment, kMeshPaint, kMeshVertex, kPaint, kSplatFragment, kSplatVertex,
} from '../../../view/shaders.h';
import type { Rebuilt } from '../client/protocol.js';
import type { Quality } from '../core/levels.js';
import { FIELD_OF_VIEW, type Camera } from './camera.js';
import { bindTexture, Program, setFilter, type GL } from './gl.js';
import { GlSurface, NUMBERS, PAINTS, UV } from './gl_surface.js';
import { Lighting, NO_SHADOW } from './lighting.js';
import { product } from './matrix.js';
import type { Style } from './style.js';
import { Surroundings } from './surroundings.js';
import { Target, type Tile } from './target.js';

/** Corners of one vertex have several UVs at seams, where the core gives several vertices. */
const TEXTURED_VERTEX = kMeshVertex.replace('void main(){', `layout(location=${UV})in vec2 vertex_uv;out vec2 uv;void main(){uv=vertex_uv;`);
const IMAGE_PAINT = 'in vec2 uv;in vec3 painted;uniform sampler2D image;uniform int times_painted;vec3 own_paint(){vec3 texel=texture(image,uv).rgb,factor=times_painted==1?painted:vec3(1.0);return uv.x>-1e30?factor*texel:factor;}';

/** Draws surfaces as the native viewer does, with its shaders: view/renderer.h. */
export class Renderer {
  readonly #gl: GL;
  readonly #target: Target;
  readonly #lighting: Lighting;
  readonly #surroundings: Surroundings;
  readonly #mesh: Program;
  readonly #textured: Program;
  readonly #line: Program;
  readonly #splat: Program;
  readonly #table: WebGLTexture;
  #isWarm = false;
  #finish: Promise<void> | import('./cloud_finish.js').CloudFinish | undefined;
  /** What was drawn without something can be drawn with it now. */
  onLoaded: () => void = () => {};

  constructor(gl: GL) {
    this.#gl = gl;
    const paint = kLighting + kPaint;
    this.#mesh = new Program(gl, 'mesh', kMeshVertex, paint + kMeshPaint + kMeshFragment);
    this.#textured = new Program(gl, 'textured mesh', TEXTURED_VERTEX, paint + IMAGE_PAINT + kMeshFragment);
    this.#line = new Program(gl, 'line', kMeshVertex, kLineFragment);
    this.#splat = new Program(gl, 'splat', kSplatVertex, paint + kSplatFragment);
    this.#target = new Target(gl);
    this.#lighting = new Lighting(gl);
    this.#surroundings = new Surroundings(gl);
    this.#mesh.start();  // Of what nearly every picture shows.
    this.#table = gl.createTexture();
    this.useTable(new Uint8Array(4));
    setFilter(gl, gl.LINEAR);
  }

  /** Drawing does not wait for shaders. */
  get isMade(): boolean {
    return this.#isWarm || (this.#mesh.isMade && this.#lighting.isMade && this.#surroundings.isMade);
  }
  /** Colours of numbers, RGBA, from now on. */
  useTable(colours: Uint8Array): void {
    const gl = this.#gl;
    bindTexture(gl, 1, this.#table);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, colours.length / 4, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, colours);
  }

  /** To a part of the canvas. */
  draw(all: readonly GlSurface[], camera: Camera, style: Style, tile: Tile, pixelScale: number, quality: Readonly<Quality>): void {
    const gl = this.#gl, there = all.filter((surface) => surface.isDrawable), surfaces = there.length > 0 ? there : this.#warmUp();
    const paint = PAINTS[style.colour] ?? NUMBERS;
    for (const surface of surfaces) surface.paint = paint;
    this.#lighting.cast(camera, surfaces, style.shadow ? quality.shadow : NO_SHADOW);
    this.#target.bind(tile, quality.samples);
    const { x, y, width, height } = tile;
    gl.viewport(x, y, width, height);
    const seen = surfaces.length > there.length ? { x, y, width: 1, height: 1 } : tile;  // Warming up takes one pixel.
    gl.scissor(x, y, seen.width, seen.height);
    gl.enable(gl.SCISSOR_TEST);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    // Alpha is coverage: colours of a picture without wall are premultiplied, as canvases want them.
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    if (style.wall) this.#surroundings.drawWall();
    this.#lighting.bind();
    if (style.shadow || style.grid) this.#surroundings.drawFloor(camera, this.#lighting, style.grid, there.length > 0, pixelScale, tile, seen);
    gl.enable(gl.DEPTH_TEST);
    this.#drawMeshes(surfaces.filter((surface) => !surface.isCloud && !style.points), camera, style);
    this.#drawPoints(surfaces.filter((surface) => surface.isCloud || style.points), camera, height, pixelScale, quality.samples > 1);
    if (style.axes) this.#surroundings.drawAxes(camera);
    if (surfaces.length > 0 && surfaces.every((surface) => surface.isCloud && !surface.hasDiscs)) this.#finishCloud(camera, tile);
    else this.#target.present(tile);
    gl.disable(gl.SCISSOR_TEST);
  }

  /** Drivers finish shaders when something is first drawn with them: that is a face without area, while no surface is there. */
  #warmUp(): GlSurface[] {
    if (this.#isWarm) return [];
    this.#isWarm = true;
    const nothing = new GlSurface(this.#gl), zeros = new Float32Array(9);
    nothing.upload({ vertices: 3, level: 3, positions: zeros, box: [0, 0, 0, 0, 0, 0], normals: zeros, triangles: new Uint32Array(3) } as Rebuilt, false, 0);
    return [nothing];
  }
  #drawMeshes(surfaces: readonly GlSurface[], camera: Camera, style: Style): void {
    if (surfaces.length === 0) return;
    const gl = this.#gl;
    const isTextured = (surface: GlSurface): boolean => style.colour === 'textured' && !style.wireframe && surface.isTextured;
    for (const program of [this.#mesh, ...(surfaces.some(isTextured) ? [this.#textured] : [])]) {
      this.#lighting.light(program, camera);
      program.set({ colour_table: 1 });
    }
    // Only under lines: the slope term would let back faces shine through along the silhouette.
    if (style.edges || style.wireframe) gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1, 1);
    // A wireframe hides what is behind the surface: its faces write depth only.
    if (style.wireframe) gl.colorMask(false, false, false, false);
    for (const surface of surfaces) {
      const withImage = isTextured(surface);
      surface.bind((withImage ? this.#textured : this.#mesh).use(), withImage);
      surface.drawTriangles();
    }
    gl.disable(gl.POLYGON_OFFSET_FILL);
    gl.colorMask(true, true, true, true);
    if (!style.edges && !style.wireframe) return;
    if (!style.wireframe) {
      this.#line.use().set({ clip_from_scene: product(camera.clipFromView, camera.viewFromScene), line_colour: [0.08, 0.05, 0.07, 0.42] });
      gl.enable(gl.BLEND);
      gl.depthMask(false);
    }
    for (const surface of surfaces) {
      surface.bind((style.wireframe ? this.#mesh : this.#line).use());
      surface.drawEdges();
    }
    gl.depthMask(true);
    gl.disable(gl.BLEND);
  }

  #drawPoints(surfaces: readonly GlSurface[], camera: Camera, height: number, pixelScale: number, isFine: boolean): void {
    if (surfaces.length === 0) return;
    const gl = this.#gl;
    this.#lighting.light(this.#splat, camera);
    this.#splat.set({
      colour_table: 1, view_from_scene: camera.viewFromScene, clip_from_view: camera.clipFromView, pixel_scale: pixelScale,
      px_per_unit: (0.5 * height) / Math.tan(0.5 * FIELD_OF_VIEW),
    });
    for (const surface of surfaces) {
      surface.bind(this.#splat);
      this.#splat.set({
        radius: (surface.isCloud ? 1.15 : 0.32) * Math.max(surface.spacing, 1e-4 * camera.radius), discs: surface.hasDiscs ? surface.scale : 0,
      });
      surface.drawPoints();
      if (!surface.hasDiscs || !isFine) continue;
      // Shade goes over from disc to disc.
      this.#splat.set({ over: 1 });
      gl.enable(gl.BLEND);
      gl.depthMask(false);
      surface.drawPoints();
      gl.depthMask(true);
      gl.disable(gl.BLEND);
      this.#splat.set({ over: 0 });
    }
  }

  #finishCloud(camera: Camera, tile: Tile): void {
    this.#finish ??= import('./cloud_finish.js').then(({ CloudFinish }) => {
      this.#finish = new CloudFinish(this.#gl, { Program, bindTexture, setFilter });
      this.onLoaded();
    });
    if (this.#finish instanceof Promise) return this.#target.present(tile);
    this.#finish.draw(this.#target, camera, tile);
    bindTexture(this.#gl, 1, this.#table);
  }
}
