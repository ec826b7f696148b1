// SPDX-License-Identifier: MIT
import { EigencastError } from '../core/module.js';
import type { Environment } from './environment.js';
import { retryDelay, tryAgainIn } from './retry.js';
import { endpoint, type BrokerUrl } from './url.js';

const FIRST_RETRY_MS = 300, LONGEST_RETRY_MS = 5000, SILENCE_MS = 15_000;

/** What is fetched of an object: all of it, or its first bytes. */
export interface Wanted {
  id: string;
  /** More is refused. */
  maxBytes: number;
  /** Only so many leading bytes, by Range. */
  firstBytes?: number;
}

/**
 * Downloads objects of assets, one after the other, and tries again until it is stopped; what a broken download brought
 * is kept. The core verifies what comes.
 */
export class ObjectFetcher {
  readonly #environment: Environment;
  readonly #broker: BrokerUrl;
  readonly #stopped = new AbortController();
  /** Why the last try failed, and when the next begins; empty while all is well. */
  trouble = '';
  downloadedBytes = 0;
  onTrouble: () => void = () => {};

  constructor(environment: Environment, broker: BrokerUrl) {
    this.#environment = environment;
    this.#broker = broker;
  }
  stop(): void {
    this.#stopped.abort();
  }
  get isStopped(): boolean {
    return this.#stopped.signal.aborted;
  }

  /**
   * Nothing: it was stopped. `good` says whether what came is what was asked for: else it is fetched anew.
   *
   * had  its first bytes, where they are known
   */
  async get(wanted: Wanted, good: (bytes: Uint8Array) => boolean, had: Uint8Array = new Uint8Array()): Promise<Uint8Array | undefined> {
    for (let failures = 0; !this.isStopped;) {
      const before = had.length;
      try {
        if (had.length < (wanted.firstBytes ?? wanted.maxBytes)) await this.#download(wanted, had, (bytes) => (had = bytes));
        if (good(had)) {
          this.trouble = '';
          return had;
        }
        had = new Uint8Array();
        throw new EigencastError('corrupt', 'it does not have the hash it is named by');
      } catch (error) {
        if (this.isStopped) return undefined;
        failures = had.length > before ? 1 : failures + 1;  // Progress: the connection was at fault, not the object.
        const waitMs = retryDelay(failures, FIRST_RETRY_MS, LONGEST_RETRY_MS, this.#environment.random());
        this.trouble = `asset object ${wanted.id.slice(0, 12)}: ${(error as Error).message}${tryAgainIn(waitMs)}`;
        this.onTrouble();
        await this.#pause(waitMs);
      }
    }
    return undefined;
  }

  #pause(waitMs: number): Promise<void> {
    return new Promise((resolve) => {
      const timer = setTimeout(end, waitMs);
      const signal = this.#stopped.signal;
      function end(): void {
        clearTimeout(timer);
        signal.removeEventListener('abort', end);
        resolve();
      }
      signal.addEventListener('abort', end);
    });
  }

  async #download({ id, maxBytes, firstBytes }: Wanted, had: Uint8Array, keep: (bytes: Uint8Array) => void): Promise<void> {
    const most = firstBytes ?? maxBytes;
    const ranged = had.length > 0 || firstBytes !== undefined;
    const quiet = new AbortController();
    const stop = (): void => quiet.abort();
    let timer = setTimeout(stop, SILENCE_MS);
    this.#stopped.signal.addEventListener('abort', stop);
    let parts = [had];
    let size = had.length;
    try {
      const answer = await this.#environment.fetch(endpoint(this.#broker, `/v1/assets/${id}`, '', 'http'), {
        signal: quiet.signal, ...(ranged ? { headers: { Range: `bytes=${had.length}-${firstBytes === undefined ? '' : firstBytes - 1}` } } : {}),
      });
      if (answer.status === 200 || answer.status === 416) [parts, size] = [[], 0];
      if (answer.status !== 200 && answer.status !== 206)
        throw new EigencastError(answer.status === 404 ? 'not-found' : 'refused', `the broker answered ${answer.status}`);
      const reader = answer.body!.getReader();
      for (let read = await reader.read(); !read.done; read = await reader.read()) {
        clearTimeout(timer);
        timer = setTimeout(stop, SILENCE_MS);
        parts.push(read.value);
        size += read.value.length;
        this.downloadedBytes += read.value.length;
        if (size <= most) continue;
        await reader.cancel();
        // A whole answer to a request of a range goes on beyond it.
        if (answer.status !== 200 || firstBytes === undefined) throw new EigencastError('too-large', `it is larger than the ${most} bytes expected`);
        break;
      }
    } catch (error) {
      if (quiet.signal.aborted && !this.isStopped) throw new EigencastError('timeout', 'the download fell silent');
      throw error;
    } finally {
      clearTimeout(timer);
      this.#stopped.signal.removeEventListener('abort', stop);
      keep(joined(parts, size).subarray(0, most));
    }
  }
}

function joined(parts: readonly Uint8Array[], size: number): Uint8Array {
  if (parts.length === 1) return parts[0]!;
  const all = new Uint8Array(size);
  let at = 0;
  for (const part of parts) {
    all.set(part, at);
    at += part.length;
  }
  return all;
}
