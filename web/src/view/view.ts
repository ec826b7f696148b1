// SPDX-License-Identifier: MIT
import type { Stream } from '../client/client.js';
import { FULL, type LevelObject, type Quality } from '../core/levels.js';
import { Camera } from './camera.js';
import { GlSurface } from './gl_surface.js';
import { LiveSurface, type Drawn } from './live_surface.js';
import { moved, type Vec3 } from './matrix.js';
import type { Legend, NumberPainter } from './numbers.js';
import type { Pickable } from './pick.js';
import type { Renderer } from './renderer.js';
import type { Picture, Stage } from './stage.js';
import { isOfNumbers, STYLE, type Colouring, type ColourMap, type Style } from './style.js';
import type { Tile } from './target.js';

/** The smallest part of its vertices that a surface keeps, and how many are never worth saving: of small pictures those that a pixel can show. */
const FLOOR = 0.02, FEW = 2000, PIXELS_A_VERTEX = 32;
/** What a key changes the largest part by, and its end. */
const LEVEL_STEP = 1.25, MIN_LEVEL = 1 / 1024;
const MAX_PIXEL_RATIO = 2;
/** Where no surface comes so soon, the floor is shown that it will stand on. */
const EMPTY_MS = 300;

/** A canvas that shows a stream's surface, drawn by the page's stage. */
export class View {
  readonly canvas: HTMLCanvasElement;
  readonly camera = new Camera();
  readonly live: LiveSurface;
  readonly #stage: Stage;
  readonly #context: CanvasRenderingContext2D;
  #style: Style = STYLE;
  #gl: GlSurface | undefined;
  #lod = 1;
  #upIsChosen = false;
  #image: ImageBitmap | undefined;
  #isDirty = true;
  #isInSight = true;
  #isHidden = false;
  #isPausedStream = false;
  #colourfulness = 1;
  #quality: Readonly<Quality> = FULL;
  #painter: NumberPainter | undefined;
  #tables: typeof import('./numbers.js').tableOf | undefined;
  #table: { map: ColourMap; colours: Uint8Array } | undefined;
  /** The surface can be textured from now on. */
  onImage: () => void = () => {};
  /** Pictures so far. */
  drawn = 0;

  constructor(stage: Stage, canvas: HTMLCanvasElement, stream: Stream) {
    this.#stage = stage;
    this.canvas = canvas;
    this.#context = canvas.getContext('2d')!;
    this.live = new LiveSurface(stream, stage.core, (drawn) => (drawn ? this.#take(drawn) : this.#frame()));
    stream.on('surface', ({ colours, normals }) => this.#gl?.dress(colours, normals));
    stream.on('image', (image) => void this.#decode(image));
    if (stream.image) void this.#decode(stream.image);
    stage.add(this);
    setTimeout(() => this.invalidate(), EMPTY_MS);
  }
  /** The stream stays as it is. */
  close(): void {
    this.#stage.remove(this);
    this.live.close();
    this.#gl?.free();
  }

  get style(): Style {
    return this.#style;
  }
  setStyle(change: Partial<Style>): void {
    const before = this.#style;
    this.#style = { ...before, ...change };
    this.live.isTextured = this.#style.colour === 'textured' && !this.#style.points;
    if (this.#style.colour !== before.colour) void this.#paintNumbers(this.#style.colour);
    this.invalidate();
  }
  /** The camera has moved, or something else that the picture shows. */
  invalidate(): void {
    this.#isDirty = true;
  }
  /** The largest part of its vertices that is drawn. */
  get lod(): number {
    return this.#lod;
  }
  finer(): void {
    this.#lod = Math.min(this.#lod * LEVEL_STEP, 1);
  }
  coarser(): void {
    this.#lod = Math.max(this.#lod / LEVEL_STEP, MIN_LEVEL);
  }
  nextUp(): void {
    this.#upIsChosen = true;
    this.camera.up = ({ x: 'y', y: 'z', z: 'x' } as const)[this.camera.up];
    this.camera.home();
    this.invalidate();
  }
  get vertices(): number {
    return this.live.drawn?.rebuilt.level ?? 0;
  }
  get faces(): number {
    return this.#gl?.faces ?? 0;
  }
  /** What the surface can show, in the native client's order. */
  get colourings(): Colouring[] {
    const { surface, isCloud, stream } = this.live, { channels = 3, velocity_channels = 0, scalars = [] } = stream.info?.format ?? {};
    const count = Math.max(0, channels - 3 - velocity_channels);
    return [
      'clay', ...(surface?.colours ? ['own' as const] : []), ...(this.#image ? ['textured' as const] : []), ...(isCloud ? [] : ['normals' as const]), 'movement',
      'speed', ...(this.live.other ? ['difference' as const] : []), ...Array.from({ length: count }, (_, i): Colouring => `channel:${scalars[i]?.name ?? 3 + i}`),
    ];
  }
  /** Of the colours, where they say numbers. */
  get legend(): Legend | undefined {
    const { surface } = this.live;
    return surface && this.#painter?.legend(this.#style, surface.facts);
  }
  set isInSight(value: boolean) {
    this.#isInSight = value;
    this.#pause();
  }
  get isInSight(): boolean {
    return this.#isInSight && !this.#isHidden;
  }
  set isHidden(value: boolean) {
    this.#isHidden = value;
    this.#pause();
  }

  /** What pick() finds points of, by `camera`. */
  get pickable(): Pickable[] {
    const rebuilt = this.live.drawn?.rebuilt, gl = this.#gl;
    if (!rebuilt || !gl) return [];
    const { sceneFromSurface, triangles, spacing } = gl;
    return [{ positions: rebuilt.positions, triangles, sceneFromSurface, radius: 1.2 * spacing }];
  }
  /** What is to be seen now as a PNG, as well as can be drawn, with or without what is behind. */
  picture(wall: boolean): Promise<Blob | null> {
    const canvas = document.createElement('canvas');
    [canvas.width, canvas.height] = this.#sizeOf(FULL);
    const style = { ...this.#style, wall, grid: wall && this.#style.grid };
    this.#stage.draw([{ to: canvas.getContext('2d')!, paint: (renderer, tile) => this.#paint(renderer, style, tile, FULL) }]);
    return new Promise((resolve) => canvas.toBlob(resolve));
  }

  /** For the stage, which draws it at once: a canvas of another size is empty until then. */
  nextPicture(): Picture {
    const { canvas } = this, [width, height] = this.#sizeOf(this.#quality);
    if (width !== canvas.width) canvas.width = width;
    if (height !== canvas.height) canvas.height = height;
    return {
      to: this.#context,
      paint: (renderer, tile) => {
        this.#paint(renderer, this.#style, tile, this.#quality);
        this.#isDirty = false;
        ++this.drawn;
      },
    };
  }
  /** Nothing that was on the GPU is there any more. */
  forgetSurface(): void {
    this.#gl = undefined;
    this.live.forgetDrawn();
  }
  /** Follows the size of the canvas on the page, and how pictures are to be drawn. */
  prepare(): void {
    const { canvas } = this, { quality } = this.#stage, [width, height] = this.#sizeOf(quality);
    if (width !== canvas.width || height !== canvas.height || quality !== this.#quality) {
      this.#quality = quality;
      this.invalidate();
    }
    this.camera.setViewport(canvas.clientWidth, canvas.clientHeight);
    const colourfulness = this.live.colourfulness(Date.now());
    if (colourfulness !== this.#colourfulness) this.invalidate();
    this.#colourfulness = colourfulness;
  }
  /** The most that are drawn of what has arrived. */
  get maxVertices(): number {
    const facts = this.live.surface?.facts;
    return facts ? Math.max(facts.baseCount, Math.min(facts.rowsReady, Math.round(this.#lod * facts.vertexCount))) : 0;
  }
  /** Nothing: there is no surface yet. */
  levelObject(): LevelObject | undefined {
    const { surface, box } = this.live;
    if (!surface || !box) return undefined;
    const { vertexCount, baseCount } = surface.facts, max = this.maxVertices, { camera } = this, eye = camera.position, { centre } = camera;
    const pixels = camera.diameterPx(centre, camera.radius), few = Math.min(FEW, (pixels * pixelRatio(FULL)) ** 2 / PIXELS_A_VERTEX);
    return {
      max, min: Math.min(max, Math.max(baseCount, Math.round(few), Math.round(FLOOR * vertexCount))), drawn: this.vertices,
      distance: Math.hypot(eye[0] - centre[0], eye[1] - centre[1], eye[2] - centre[2]),
      pixels, vertexCost: this.live.isCloud ? 0.5 : 1,
    };
  }
  advance(nowUs: number, level: number): void {
    const { centre, radius } = this.camera;
    this.live.advance(nowUs, level, ((this.#gl?.scale ?? 1) * this.camera.diameterPx(centre, radius)) / (2 * radius));
    if (this.#isDirty) this.#stage.show(this);
  }

  #sizeOf(quality: Readonly<Quality>): [number, number] {
    const ratio = pixelRatio(quality);
    return [Math.round(this.canvas.clientWidth * ratio), Math.round(this.canvas.clientHeight * ratio)];
  }
  #take({ rebuilt, isCloud, area }: Drawn): void {
    if (!this.#stage.renderer) return;  // It asks again when it is back.
    if (!this.#gl) {
      this.#gl = new GlSurface(this.#stage.gl);
      this.#gl.dress(this.live.surface?.colours, this.live.surface?.normals);
      if (this.#image) this.#gl.texture(this.#image);
    }
    this.#gl.upload(rebuilt, isCloud, area);
    this.#stage.show(this);
  }
  /** What cannot be decoded leaves the surface as it is. */
  async #decode(image: Uint8Array): Promise<void> {
    const { decoded } = await import('./image.js'), { gl } = this.#stage, bitmap = await decoded(image, gl.getParameter(gl.MAX_TEXTURE_SIZE) as number);
    this.#image = bitmap;
    if (!bitmap) return;
    this.#gl?.texture(bitmap);
    this.invalidate();
    this.onImage();
  }
  /** The camera frames what the scene's box holds. */
  #frame(): void {
    const { box, outline, surface, sceneFromSurface } = this.live;
    if (!box || !surface) return;
    if (!this.#upIsChosen) this.camera.up = surface.facts.upAxis === 'unknown' ? 'y' : surface.facts.upAxis;
    const corners = Array.from({ length: 8 }, (_, i) =>
      moved(sceneFromSurface, [box[i & 1]![0], box[(i >> 1) & 1]![1], box[(i >> 2) & 1]![2]]));
    const most = (choose: (...values: number[]) => number): Vec3 =>
      [0, 1, 2].map((axis) => choose(...corners.map((corner) => corner[axis]!))) as unknown as Vec3;
    this.camera.setScene(most(Math.min), most(Math.max), outline.map((point) => moved(sceneFromSurface, point)));
    this.invalidate();
  }
  #paint(renderer: Renderer, style: Style, tile: Tile, quality: Readonly<Quality>): void {
    const gl = this.#gl;
    gl?.place(this.live.sceneFromSurface);
    if (gl) gl.colourfulness = this.#colourfulness;
    if (gl && this.#painter) {
      gl.range = this.#painter.span(style);
      if (this.#table?.map !== style.colourMap) this.#table = { map: style.colourMap, colours: this.#tables!(style.colourMap) };
      renderer.useTable(this.#table.colours);
    }
    renderer.draw(gl ? [gl] : [], this.camera, style, tile, pixelRatio(quality), quality);
  }
  async #paintNumbers(colour: Colouring): Promise<void> {
    if (!isOfNumbers(colour)) return void (this.live.painter = this.#painter = undefined);
    const { NumberPainter, tableOf } = await import('./numbers.js');
    if (colour !== this.#style.colour) return;
    this.#tables = tableOf;
    this.live.painter = this.#painter = new NumberPainter(colour);
  }
  #pause(): void {
    if (this.#isPausedStream === !this.isInSight) return;
    this.#isPausedStream = !this.isInSight;
    if (this.#isPausedStream) this.live.stream.pause();
    else this.live.stream.resume();
  }
}

const pixelRatio = ({ resolution }: Readonly<Quality>): number => Math.min(devicePixelRatio, MAX_PIXEL_RATIO) * resolution;
