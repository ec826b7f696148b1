// SPDX-License-Identifier: MIT
import type { Rebuilt } from '../client/protocol.js';
import { linearFrom } from '../core/colours.js';
import { bindTexture, type GL, type Program } from './gl.js';
import { determinant, IDENTITY, moved, normalMatrix, type Mat4, type Vec3 } from './matrix.js';

/** Numbers of kMeshVertex and kSplatVertex. */
const POSITION = 0, NORMAL = 1, PAINT = 2, RADIUS = 3, OWN_NORMALS = 6;
/** Of the renderer's. */
export const UV = 4;
/** Of their own, so that colours stay. */
const NUMBERS_BUFFER = 5;
/** Texture units; 0 and 1 belong to shadow map and colour table. */
const IMAGE_UNIT = 2;
const ANISOTROPY = 8;
/** Modes of kPaint; others: numbers. */
export const PAINTS: { readonly [colour: string]: number } = { clay: 0, own: 2, textured: 2, normals: 3 };
export const NUMBERS = 1;

/** One surface as the GPU draws it. */
export class GlSurface {
  readonly #gl: GL;
  readonly #array: WebGLVertexArrayObject;
  readonly #buffers: WebGLBuffer[];
  readonly #triangles: WebGLBuffer;
  readonly #edges: WebGLBuffer;
  #vertices = 0;
  #indices: Uint32Array = new Uint32Array();
  #edgesAreThere = false;
  #colours: Uint8Array | undefined;
  #normals: Uint8Array | undefined;
  #origins: Uint32Array | undefined;
  #level = 0;
  #hasNumbers = false;
  #image: WebGLTexture | undefined;
  #hasUvs = false;
  #sceneFromSurface: Mat4 = IDENTITY;
  #scale = 1;
  #spacing = 0;
  #box: readonly number[] = [];
  isCloud = false;
  hasDiscs = false;
  /** A mode of kPaint. */
  paint = PAINTS.clay!;
  /** Of the ends of the colour table. */
  range: readonly [low: number, high: number] = [0, 1];
  /** 1: its colours; 0: grey, as of a lost connection. */
  colourfulness = 1;

  constructor(gl: GL) {
    this.#gl = gl;
    this.#array = gl.createVertexArray();
    this.#buffers = Array.from({ length: 7 }, () => gl.createBuffer());
    this.#triangles = gl.createBuffer();
    this.#edges = gl.createBuffer();
  }
  free(): void {
    const gl = this.#gl;
    gl.deleteVertexArray(this.#array);
    if (this.#image) gl.deleteTexture(this.#image);
    for (const buffer of [...this.#buffers, this.#triangles, this.#edges]) gl.deleteBuffer(buffer);
  }

  /** area: of the surface, in its units. */
  upload(rebuilt: Rebuilt, isCloud: boolean, area: number): void {
    const gl = this.#gl;
    gl.bindVertexArray(this.#array);
    this.#vertices = rebuilt.vertices;
    this.#box = rebuilt.box;
    this.#level = rebuilt.level;
    this.#spacing = Math.sqrt(area / Math.max(rebuilt.level, 1));
    this.isCloud = isCloud;
    this.#set(POSITION, rebuilt.positions, 3);
    this.#set(NORMAL, rebuilt.normals, 3);
    if (rebuilt.numbers) this.#set(PAINT, rebuilt.numbers, 1, NUMBERS_BUFFER);
    else if (this.#hasNumbers) this.#point(PAINT, this.#colours !== undefined, 3);
    this.#hasNumbers = rebuilt.numbers !== undefined;
    if (!rebuilt.triangles) return;
    this.hasDiscs = rebuilt.radii !== undefined;
    this.#set(RADIUS, rebuilt.radii, 1);
    this.#hasUvs = rebuilt.uvs !== undefined;
    this.#set(UV, rebuilt.uvs, 2);
    if (this.#origins !== rebuilt.origins) this.#paint(rebuilt.origins);
    this.#indices = rebuilt.triangles;
    this.#edgesAreThere = false;
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.#triangles);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, this.#indices, gl.STATIC_DRAW);
  }
  /** rows x 3, sRGB, and a row each of the file's own; nothing: it has none. */
  dress(colours: Uint8Array | undefined, normals: Uint8Array | undefined): void {
    this.#gl.bindVertexArray(this.#array);
    this.#colours = colours;
    this.#normals = normals;
    this.#paint(this.#origins);
  }
  /** Its texture, at most as large as the GPU takes. */
  texture(image: ImageBitmap): void {
    const gl = this.#gl, fine = gl.getExtension('EXT_texture_filter_anisotropic');
    if (this.#image) gl.deleteTexture(this.#image);
    this.#image = gl.createTexture();
    bindTexture(gl, IMAGE_UNIT, this.#image);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.SRGB8_ALPHA8, gl.RGBA, gl.UNSIGNED_BYTE, image);
    gl.generateMipmap(gl.TEXTURE_2D);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    if (fine) gl.texParameterf(gl.TEXTURE_2D, fine.TEXTURE_MAX_ANISOTROPY_EXT, ANISOTROPY);
  }
  place(sceneFromSurface: Mat4): void {
    this.#sceneFromSurface = sceneFromSurface;
    this.#scale = Math.cbrt(Math.abs(determinant(sceneFromSurface)));
  }

  /** With an image, and UVs. */
  get isTextured(): boolean {
    return this.#image !== undefined && this.#hasUvs;
  }
  get isDrawable(): boolean {
    return this.#vertices > 0;
  }
  get vertices(): number {
    return this.#vertices;
  }
  get faces(): number {
    return this.#indices.length / 3;
  }
  get sceneFromSurface(): Mat4 {
    return this.#sceneFromSurface;
  }
  /** Of the box of what is drawn, scene units. */
  get corners(): Vec3[] {
    return Array.from({ length: 8 }, (_, i) => moved(this.#sceneFromSurface, [this.#box[i & 1 ? 3 : 0]!, this.#box[i & 2 ? 4 : 1]!, this.#box[i & 4 ? 5 : 2]!]));
  }
  /** Three indices a triangle. */
  get triangles(): Uint32Array {
    return this.#indices;
  }
  /** From surface to scene. */
  get scale(): number {
    return this.#scale;
  }
  /** Between points, scene units. */
  get spacing(): number {
    return this.#spacing * this.#scale;
  }

  /** Sets the program's transform and binds the arrays, and the image, which is multiplied with its colours. */
  bind(program: Program, withImage = false): void {
    const isPainted = (this.#colours?.length ?? 0) >= 3 * this.#level;
    const isThere = this.paint === NUMBERS ? this.#hasNumbers : this.paint !== PAINTS.own || withImage || isPainted;
    program.set({
      times_painted: isPainted ? 1 : 0,
      paint: isThere ? this.paint : PAINTS.clay!, colour_range: this.range, colourfulness: this.colourfulness, scene_from_surface: this.#sceneFromSurface, scene_from_normal: normalMatrix(this.#sceneFromSurface),
    });
    if (withImage && this.#image) {
      program.set({ image: IMAGE_UNIT });
      bindTexture(this.#gl, IMAGE_UNIT, this.#image);
    }
    this.#gl.bindVertexArray(this.#array);
  }
  drawTriangles(): void {
    this.#draw(this.#gl.TRIANGLES, this.#triangles, this.#indices.length);
  }
  /** Those of each triangle, so that an inner one is drawn twice, as by glPolygonMode. */
  drawEdges(): void {
    const gl = this.#gl;
    if (!this.#edgesAreThere) {
      const ends = new Uint32Array(2 * this.#indices.length);
      this.#indices.forEach((vertex, i) => {
        ends[2 * i] = vertex;
        ends[2 * i + 1] = this.#indices[i % 3 === 2 ? i - 2 : i + 1]!;
      });
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.#edges);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, ends, gl.STATIC_DRAW);
      this.#edgesAreThere = true;
    }
    this.#draw(gl.LINES, this.#edges, 2 * this.#indices.length);
  }
  drawPoints(): void {
    this.#gl.drawArrays(this.#gl.POINTS, 0, this.#vertices);
  }

  #paint(origins: Uint32Array | undefined): void {
    this.#origins = origins;
    const normals = this.#normals;
    this.#set(PAINT, this.#colours && linearFrom(this.#colours, origins), 3);
    this.#set(OWN_NORMALS, normals && Float32Array.from(origins ?? normals, (at) => (origins ? normals[at]! : at)), 1);
    if (this.#hasNumbers) this.#point(PAINT, true, 1, NUMBERS_BUFFER);
  }
  #draw(what: number, indices: WebGLBuffer, count: number): void {
    this.#gl.bindBuffer(this.#gl.ELEMENT_ARRAY_BUFFER, indices);
    this.#gl.drawElements(what, count, this.#gl.UNSIGNED_INT, 0);
  }
  #set(number: number, values: Float32Array | undefined, size: number, buffer = number): void {
    const gl = this.#gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.#buffers[buffer]!);
    if (values) gl.bufferData(gl.ARRAY_BUFFER, values, gl.STREAM_DRAW);
    this.#point(number, values !== undefined, size, buffer);
  }
  #point(number: number, isThere: boolean, size: number, buffer = number): void {
    const gl = this.#gl;
    if (!isThere) {
      gl.disableVertexAttribArray(number);
      gl.vertexAttrib3f(number, 0, 0, 0);
      return;
    }
    gl.bindBuffer(gl.ARRAY_BUFFER, this.#buffers[buffer]!);
    gl.vertexAttribPointer(number, size, gl.FLOAT, false, 0, 0);
    gl.enableVertexAttribArray(number);
  }
}
