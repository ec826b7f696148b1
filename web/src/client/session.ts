// SPDX-License-Identifier: MIT
import { Core, EigencastError } from '../core/module.js';
import { streamIdOf } from '../core/frames.js';
import { Surface } from '../core/surface.js';
import { BrokerConnection, type Request } from './connection.js';
import type { Environment } from './environment.js';
import type { Rebuild, Rebuilt, ToPage, ToWorker } from './protocol.js';
import { Subscription, type Observer } from './subscription.js';
import type { Limits } from './surface_source.js';
import type { BrokerUrl } from './url.js';

/** Where poses and their surface come from. */
type Watching = Pick<Subscription, 'surfaces' | 'change' | 'pause' | 'end'>;

interface Watched {
  subscription: Watching;
  surface: Surface;
  /** Rows and asset that `surface` has taken. */
  taken: string;
}

/** What a worker does for its page: the socket, frames, assets and rebuilding of one broker's streams. */
export class Session {
  readonly #core: Core;
  readonly #environment: Environment;
  readonly #broker: BrokerUrl;
  readonly #connection: BrokerConnection;
  readonly #post: (message: ToPage, transfer: Transferable[]) => void;
  readonly #watched = new Map<number, Watched>();

  constructor(core: Core, environment: Environment, broker: BrokerUrl, post: (message: ToPage, transfer: Transferable[]) => void) {
    this.#core = core;
    this.#environment = environment;
    this.#broker = broker;
    this.#post = post;
    this.#connection = new BrokerConnection(environment, broker, (frame) => streamIdOf(core, frame));
    this.#connection.onText = (text) => post({ op: 'room', key: 0, text }, []);
  }

  receive(message: ToWorker): void {
    switch (message.op) {
      case 'begin':
      case 'core':
        return;
      case 'watch':
        return this.#watch(message);
      case 'profile':
        return this.#watched.get(message.key)?.subscription.change(message.profile);
      case 'pause':
        return this.#watched.get(message.key)?.subscription.pause(message.isPaused);
      case 'leave':
        return this.#leave(message.key);
      case 'rebuild':
        return this.#answer(message.key, message.request, message.rebuild);
      case 'sources':
        return this.#sources(message);
      case 'room':
        return this.#connection.sendText(message.text);
      case 'retry':
        return this.#connection.retryNow();
      case 'end':
        for (const key of [...this.#watched.keys()]) this.#leave(key);
        this.#connection.close();
    }
  }

  protected open(request: Request & Limits, observer: Observer): Watching {
    return new Subscription(this.#core, this.#environment, this.#broker, this.#connection, request, observer);
  }
  #watch({ key, ...request }: ToWorker & { op: 'watch' }): void {
    const post = this.#post;
    try {
      const subscription = this.open(request, {
        onStatus: (status) => post({ op: 'status', key, status }, []),
        onInfo: (info) => post({ op: 'info', key, info }, []),
        onSurface: (surface) => post({ op: 'surface', key, surface }, []),
        onImage: (image) => post({ op: 'image', key, image }, [image.buffer as ArrayBuffer]),
        onPose: (pose) => post({ op: 'pose', key, pose }, [pose.coefficients.buffer, ...(pose.next ? [pose.next.coefficients.buffer] : [])]),
      });
      this.#watched.set(key, { subscription, surface: new Surface(this.#core), taken: '' });
    } catch (error) {
      this.#fail(key, error);
    }
  }
  #leave(key: number): void {
    const watched = this.#watched.get(key);
    this.#watched.delete(key);
    watched?.subscription.end();
    watched?.surface.free();
  }
  #answer(key: number, request: number, rebuild: Rebuild): void {
    const watched = this.#watched.get(key);
    try {
      if (!watched) throw new EigencastError('not-found', 'the stream is not watched (yet)');
      const rebuilt = this.#rebuild(watched, rebuild);
      const arrays = [rebuilt.positions, rebuilt.normals, rebuilt.radii, rebuilt.uvs, rebuilt.origins, rebuilt.triangles, rebuilt.numbers, rebuilt.points].filter((array) => array !== undefined);
      this.#post({ op: 'rebuilt', key, request, rebuilt }, arrays.map((array) => array.buffer as ArrayBuffer));
    } catch (error) {
      this.#fail(key, error, request);
    }
  }
  #sources({ key, request, vertices, isTextured }: ToWorker & { op: 'sources' }): void {
    const reader = this.#watched.get(key)?.subscription.surfaces.shown?.reader;
    const sources = vertices.map((vertex) => (reader ? this.#core.exports.asset_source(reader.at, vertex, isTextured ? 1 : 0) : 0xffffffff));
    this.#post({ op: 'sources', key, request, sources }, [sources.buffer]);
  }
  #rebuild(watched: Watched, { coefficients, channels, level, rank, numbers, isTextured, pxPerUnit, points, room, trianglesVersion }: Rebuild): Rebuilt {
    const shown = watched.subscription.surfaces.shown;
    if (!shown?.reader) throw new EigencastError('not-found', 'nothing of the surface has arrived yet');
    if (![shown.reader.rank, shown.before].includes(coefficients.length / channels)) throw new EigencastError('invalid-argument', 'the pose is of another surface');
    const started = this.#environment.nowUs();
    const taken = `${shown.reader.at} ${shown.asset} ${shown.isPrefix} ${shown.reader.next}`;
    if (taken !== watched.taken) {
      watched.surface.update(shown.reader);
      watched.taken = taken;
    }
    const made = watched.surface.rebuild(shown.reader, coefficients, channels, level, rank, isTextured, pxPerUnit, started);
    const isKnown = made.trianglesVersion === trianglesVersion;
    const copied = (values: Float32Array, buffer?: ArrayBuffer): Float32Array => {
      const to = buffer && buffer.byteLength >= values.byteLength ? new Float32Array(buffer, 0, values.length) : new Float32Array(values.length);
      to.set(values);
      return to;
    };
    const geometry = {
      epoch: shown.info!.epoch,
      vertices: made.vertices,
      level: made.level,
      isMoving: made.isMoving,
      positions: copied(made.positions, room?.positions),
      box: boxOf(made.positions),
      normals: made.normals && copied(made.normals, room?.normals),
      radii: isKnown ? undefined : made.radii?.slice(),
      uvs: isKnown ? undefined : made.uvs?.slice(),
      origins: isKnown ? undefined : made.origins?.slice(),
      triangles: isKnown ? undefined : made.triangles.slice(),
      trianglesVersion: made.trianglesVersion,
    };
    shown.rebuilt();
    const placed = points && watched.surface.points(shown.reader, coefficients, channels, points).slice();
    const numbered = numbers && watched.surface.numbers(shown.reader, numbers.coefficients, numbers.isLength);
    return { ...geometry, numbers: numbered?.values.slice(), range: numbered?.range, points: placed, tookMs: (this.#environment.nowUs() - started) / 1000 };
  }
  #fail(key: number, error: unknown, request?: number): void {
    const code = error instanceof EigencastError ? error.code : 'internal';
    this.#post({ op: 'failed', key, code, message: (error as Error).message, ...(request === undefined ? {} : { request }) }, []);
  }
}

function boxOf(positions: Float32Array): number[] {
  const box = [Infinity, Infinity, Infinity, -Infinity, -Infinity, -Infinity];
  for (let i = 0; i < positions.length; i += 3) {
    for (let axis = 0; axis < 3; ++axis) {
      const at = positions[i + axis]!;
      if (at < box[axis]!) box[axis] = at;
      if (at > box[axis + 3]!) box[axis + 3] = at;
    }
  }
  return box;
}
