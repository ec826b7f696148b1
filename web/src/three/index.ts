// SPDX-License-Identifier: MIT
/** `eigencast/three`: a stream's surface as a mesh of three.js. */
import {
  BufferAttribute, BufferGeometry, DoubleSide, InstancedBufferAttribute, InstancedBufferGeometry, Matrix4, Mesh, MeshStandardMaterial, Ray, Sphere, SRGBColorSpace, Texture, Vector3,
  type Intersection, type Material, type Object3DEventMap, type Raycaster,
} from 'three';
import { boundsOf, Feed, type FeedOptions } from '../adapter/feed.js';
import { imageOf } from '../adapter/paint.js';
import type { Stream } from '../client/client.js';
import type { Status, Surface } from '../client/subscription.js';
import type { EigencastError } from '../core/module.js';
import { linearFrom } from '../core/colours.js';
import type { Drawn } from '../view/live_surface.js';

export interface EigencastMeshOptions extends FeedOptions {
  /** Yours, and left as it is; `color` and `uv` of the geometry and `texture` are there for it. Default: lit clay, or the surface's own colours or image. */
  material?: Material;
}
export interface EigencastMeshEvents extends Object3DEventMap {
  status: { status: Status };
  /** The geometry can be drawn, or has grown; the first time `boundingSphere` is there. */
  surface: { surface: Surface };
  /** What cannot be put right by waiting. */
  error: { error: EigencastError };
}

type Linear = readonly [number, number, number];
const CLAY: Linear = [0.7, 0.185, 0.115], WHITE: Linear = [1, 1, 1];
/** Of a point without a disc, to the distance between points. */
const POINT = 0.75;
const CORNERS = 6;

/** Each instance is a disc around `centre`, across `facing`, or to the eye where that is nothing. */
function drawsDiscs(material: Material): void {
  material.onBeforeCompile = (shader) => {
    shader.vertexShader = shader.vertexShader
      .replace('#include <common>', '#include <common>\nattribute vec3 centre, facing;\nattribute float disc;')
      .replace('#include <beginnormal_vertex>', `
        bool is_disc = dot(facing, facing) > 0.25;
        vec3 toward = is_disc ? facing : normalize((inverse(modelMatrix) * vec4(cameraPosition, 1.0)).xyz - centre);
        vec3 across = normalize(cross(toward, abs(toward.y) < 0.9 ? vec3(0.0, 1.0, 0.0) : vec3(1.0, 0.0, 0.0)));
        vec3 outward = position.x * across + position.y * cross(toward, across);
        vec3 objectNormal = is_disc ? facing : normalize(toward + 0.55 * outward);`)
      .replace('#include <begin_vertex>', 'vec3 transformed = centre + disc * outward;');
  };
}

function discGeometry(): InstancedBufferGeometry {
  const geometry = new InstancedBufferGeometry(), rim = Array.from({ length: CORNERS }, (_, i) => (2 * Math.PI * i) / CORNERS);
  geometry.setAttribute('position', new BufferAttribute(Float32Array.from(rim.flatMap((angle) => [Math.cos(angle), Math.sin(angle), 0])), 3));
  geometry.setAttribute('normal', new BufferAttribute(Float32Array.from(rim.flatMap(() => [0, 0, 1])), 3));
  geometry.setIndex(rim.slice(2).flatMap((_, i) => [0, i + 1, i + 2]));
  return geometry;
}

/**
 * A mesh that moves as its stream does: add it to a scene, call update() before each picture, dispose() in the end. In
 * the surface's own units and axes; `world` is where its sender has it. Points become discs, for WebGLRenderer.
 */
export class EigencastMesh extends Mesh<BufferGeometry, Material, EigencastMeshEvents> {
  /** From surface to scene, as the sender says. */
  readonly world = new Matrix4();
  /** Its image, once it has come. */
  texture: Texture | undefined;
  status: Status | undefined;
  readonly #feed: Feed;
  readonly #own: MeshStandardMaterial | undefined;
  #colours: Uint8Array | undefined;
  #origins: Uint32Array | undefined;
  #isCloud = false;
  #isDisposed = false;

  constructor(url: string, options: EigencastMeshOptions = {}) {
    const { material, ...feed } = options, own = material ? undefined : new MeshStandardMaterial({ roughness: 0.75, side: DoubleSide });
    super(new BufferGeometry(), material ?? own);
    own?.color.setRGB(...CLAY);
    this.#own = own;
    this.geometry.boundingSphere = new Sphere();
    this.#feed = new Feed(url, feed, {
      drawn: (drawn, surface) => this.#take(drawn, surface),
      status: (status) => this.dispatchEvent({ type: 'status', status: (this.status = status) }),
      error: (error) => this.dispatchEvent({ type: 'error', error }),
      image: (image) => void this.#decode(image),
      surface: () => {},
    });
  }
  /** Nothing before its broker's address is known. */
  get stream(): Stream | undefined {
    return this.#feed.stream;
  }
  /** The part of its vertices that is drawn, 0 to 1. */
  get detail(): number {
    return this.#feed.detail;
  }
  set detail(part: number) {
    this.#feed.detail = part;
  }
  /** Asks for the pose of the moment, which the next pictures show. `renderer`: for its textures. */
  update(renderer?: { capabilities?: { getMaxAnisotropy(): number } }): void {
    if (this.texture && renderer?.capabilities) this.texture.anisotropy = Math.min(8, renderer.capabilities.getMaxAnisotropy());
    this.#feed.advance();
  }
  /** Leaves the stream, and gives the GPU's memory back. */
  override dispose(): void {
    this.#isDisposed = true;
    this.#feed.close();
    this.geometry.dispose();
    this.#own?.dispose();
    this.texture?.dispose();
    this.dispatchEvent({ type: 'dispose' });
  }
  /** A mesh with the same geometry, which moves, too. */
  override clone(recursive?: boolean): this {
    return new Mesh(this.geometry, this.material).copy(this as Mesh, recursive) as this;
  }
  /** Of points, the nearest disc that is hit; `index`: its row. */
  override raycast(raycaster: Raycaster, hits: Intersection[]): void {
    const sphere = this.geometry.boundingSphere;
    if (!this.#isCloud) return super.raycast(raycaster, hits);
    const ray = new Ray().copy(raycaster.ray).applyMatrix4(new Matrix4().copy(this.matrixWorld).invert());
    if (!sphere || !ray.intersectsSphere(sphere)) return;
    const centres = this.geometry.getAttribute('centre'), facings = this.geometry.getAttribute('facing'), discs = this.geometry.getAttribute('disc');
    const centre = new Vector3(), facing = new Vector3(), toward = ray.direction.clone().normalize();
    let nearest = Infinity, row = -1;
    for (let i = 0; i < centres.count; ++i) {
      centre.fromBufferAttribute(centres, i).sub(ray.origin);
      facing.fromBufferAttribute(facings, i);
      if (facing.lengthSq() < 0.25) facing.copy(toward);
      const along = centre.dot(facing) / toward.dot(facing);
      if (along > 0 && along < nearest && centre.addScaledVector(toward, -along).length() <= discs.getX(i)) [nearest, row] = [along, i];
    }
    if (row < 0) return;
    const point = ray.origin.clone().addScaledVector(toward, nearest).applyMatrix4(this.matrixWorld), distance = raycaster.ray.origin.distanceTo(point);
    if (distance >= raycaster.near && distance <= raycaster.far) hits.push({ distance, point, object: this, index: row });
  }

  #take({ rebuilt, isCloud, area }: Drawn, surface: Surface): void {
    if (isCloud !== this.#isCloud) this.#become(isCloud);
    const { geometry } = this, spacing = Math.sqrt(area / Math.max(rebuilt.level, 1)), isFirst = geometry.boundingSphere!.radius < 0;
    const [positions, normals] = isCloud ? ['centre', 'facing'] : ['position', 'normal'];
    if (geometry.getAttribute(positions!)?.array.length !== rebuilt.positions.length) geometry.dispose();  // Another size takes other buffers.
    this.#set(positions!, rebuilt.positions, 3);
    this.#set(normals!, rebuilt.normals ?? (isCloud ? new Float32Array(3 * rebuilt.vertices) : undefined), 3);
    if (rebuilt.triangles) {
      if (isCloud) this.#set('disc', rebuilt.radii ?? new Float32Array(rebuilt.vertices).fill(POINT * spacing), 1);
      else geometry.setIndex(new BufferAttribute(rebuilt.triangles, 1));
      this.#set('uv', rebuilt.uvs?.map((part) => (part < -1e30 ? 0 : part)), 2);
    }
    if (rebuilt.triangles) this.#origins = rebuilt.origins;
    const colours = (surface.colours?.length ?? 0) < 3 * rebuilt.level ? undefined : surface.colours;
    if (rebuilt.triangles || colours !== this.#colours) this.#set('color', colours && linearFrom(colours.subarray(0, 3 * rebuilt.level), this.#origins), 3);
    this.#colours = colours;
    if (isCloud) (geometry as InstancedBufferGeometry).instanceCount = rebuilt.vertices;
    const { low, high, centre, radius } = boundsOf(rebuilt.positions, isCloud ? 2 * spacing : 0);
    geometry.boundingSphere!.set(new Vector3(...centre), radius);
    geometry.boundingBox?.set(new Vector3(...low), new Vector3(...high));
    this.world.fromArray(this.#feed.live!.sceneFromSurface);
    this.#paint();
    if (isFirst || rebuilt.triangles) this.dispatchEvent({ type: 'surface', surface });
  }
  #become(isCloud: boolean): void {
    this.#isCloud = isCloud;
    this.geometry.dispose();
    this.geometry = isCloud ? discGeometry() : new BufferGeometry();
    this.geometry.boundingSphere = new Sphere();
    if (isCloud) drawsDiscs(this.material);
    else this.material.onBeforeCompile = () => {};
    this.material.needsUpdate = true;
  }
  /** Its own material follows what the surface has. */
  #paint(): void {
    const own = this.#own, map = this.geometry.hasAttribute('uv') ? (this.texture ?? null) : null, vertexColors = this.geometry.hasAttribute('color');
    if (!own || (own.map === map && own.vertexColors === vertexColors)) return;
    Object.assign(own, { map, vertexColors, needsUpdate: true });
    own.color.setRGB(...(map || vertexColors ? WHITE : CLAY));
  }
  #set(name: string, values: Float32Array | undefined, size: number): void {
    const { geometry } = this, had = geometry.getAttribute(name) as BufferAttribute | undefined;
    if (!values) geometry.deleteAttribute(name);
    else if (had?.array.length === values.length) {
      had.array = values;
      had.needsUpdate = true;
    } else geometry.setAttribute(name, this.#isCloud ? new InstancedBufferAttribute(values, size) : new BufferAttribute(values, size));
  }
  async #decode(image: Uint8Array): Promise<void> {
    const bitmap = await imageOf(image);
    if (!bitmap || this.#isDisposed) return;
    this.texture?.dispose();
    this.texture = new Texture(bitmap);
    Object.assign(this.texture, { flipY: false, colorSpace: SRGBColorSpace, needsUpdate: true });
    this.#feed.isTextured = true;
    this.#paint();
  }
}
