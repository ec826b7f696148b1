// SPDX-License-Identifier: MIT
/** `eigencast/babylon`: a stream's surface for a mesh of Babylon.js. Imports nothing of it: it takes your mesh. */
import { Feed, type FeedOptions } from '../adapter/feed.js';
import { blobOf } from '../adapter/paint.js';
import type { Stream } from '../client/client.js';
import { Events } from '../client/events.js';
import type { Status, Surface } from '../client/subscription.js';
import type { EigencastError } from '../core/module.js';
import type { Drawn } from '../view/live_surface.js';

/** What is used of a BABYLON.Mesh, of any package and version. */
export interface BabylonMesh {
  isUnIndexed: boolean;
  setVerticesData(kind: string, data: Float32Array, updatable?: boolean): unknown;
  updateVerticesData(kind: string, data: Float32Array, updateExtends?: boolean): unknown;
  removeVerticesData(kind: string): unknown;
  isVerticesDataPresent(kind: string): boolean;
  setIndices(indices: Uint32Array, totalVertices?: number): unknown;
  getScene(): { onBeforeRenderObservable: Observable };
  onDisposeObservable: Observable;
}
interface Observable {
  add(heard: () => void): unknown;
  removeCallback(heard: () => void): unknown;
}
export interface EigencastSurfaceEvents {
  status: Status;
  /** The mesh can be drawn, or has grown. */
  surface: Surface;
  error: EigencastError;
  /** URL of its image, for a texture that is not flipped; of use until dispose(). */
  image: string;
}

/**
 * Moves a mesh as its stream does, before each picture of the mesh's scene, until one of them is disposed of. In the
 * surface's own units and axes, right-handed (`scene.useRightHandedSystem = true`). A surface of points is drawn by a
 * material with `pointsCloud`.
 */
export class EigencastSurface extends Events<EigencastSurfaceEvents> {
  status: Status | undefined;
  readonly mesh: BabylonMesh;
  readonly #feed: Feed;
  readonly #advance: () => void;
  #vertices = 0;
  #coloured: Uint8Array | undefined;
  #origins: Uint32Array | undefined;
  #image = '';

  constructor(mesh: BabylonMesh, url: string, options: FeedOptions = {}) {
    super();
    this.mesh = mesh;
    this.#feed = new Feed(url, options, {
      drawn: (drawn, surface) => this.#take(drawn, surface),
      status: (status) => this.emit('status', (this.status = status)),
      error: (error) => this.emit('error', error),
      image: (image) => {
        URL.revokeObjectURL(this.#image);
        this.#image = URL.createObjectURL(blobOf(image));
        this.#feed.isTextured = true;
        this.emit('image', this.#image);
      },
      surface: () => {},
    });
    this.#advance = () => this.#feed.advance();
    mesh.getScene().onBeforeRenderObservable.add(this.#advance);
    mesh.onDisposeObservable.add(() => this.dispose());
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
  /** Leaves the stream; the mesh stays as it is. */
  dispose(): void {
    this.mesh.getScene().onBeforeRenderObservable.removeCallback(this.#advance);
    this.#feed.close();
    URL.revokeObjectURL(this.#image);
  }

  #take({ rebuilt, isCloud }: Drawn, surface: Surface): void {
    const { mesh } = this, isOther = rebuilt.vertices !== this.#vertices;
    const set = (kind: string, data: Float32Array | undefined): void => {
      if (!data) {
        if (mesh.isVerticesDataPresent(kind)) mesh.removeVerticesData(kind);
      } else if (isOther || !mesh.isVerticesDataPresent(kind)) mesh.setVerticesData(kind, data, true);
      else mesh.updateVerticesData(kind, data, kind === 'position');
    };
    this.#vertices = rebuilt.vertices;
    set('position', rebuilt.positions);
    set('normal', rebuilt.normals);
    if (rebuilt.triangles) {
      mesh.isUnIndexed = isCloud;
      set('uv', rebuilt.uvs?.map((part) => (part < -1e30 ? 0 : part)));
      mesh.setIndices(rebuilt.triangles, rebuilt.vertices);
    }
    if (rebuilt.triangles) this.#origins = rebuilt.origins;
    const colours = (surface.colours?.length ?? 0) < 3 * rebuilt.level ? undefined : surface.colours, origins = this.#origins;
    if (rebuilt.triangles || colours !== this.#coloured)
      set('color', colours && Float32Array.from({ length: 4 * rebuilt.vertices }, (_, i) => (i % 4 === 3 ? 1 : colours[3 * (origins ? origins[i >> 2]! : i >> 2) + (i % 4)]! / 255)));
    this.#coloured = colours;
    if (rebuilt.triangles) this.emit('surface', surface);
  }
}
