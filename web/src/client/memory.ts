// SPDX-License-Identifier: MIT
import type { Frames } from '../core/frames.js';
import { EigencastError, type Core } from '../core/module.js';
import type { Remember } from './control.js';
import type { ObjectFetcher } from './objects.js';

const MAX_SEGMENTS = 256, MAX_SEGMENT_BYTES = 8 << 20;

/** Fetches the poses that a stream's keys may be predicted from, and gives them to the decoder: sdk/memory_fetcher.h. */
export class MemoryFetcher {
  #segments: string[] = [];
  #generation = 0;
  /** Of them the decoder has so many. */
  #taken = 0;
  /** Undefined: nothing is fetched. */
  #fetcher: ObjectFetcher | undefined;

  /**
   * over  neither frames nor held are used any more
   * held  is called with the generation whose poses the decoder has; 0: none
   */
  constructor(readonly core: Core, readonly newFetcher: () => ObjectFetcher, readonly frames: Frames, readonly asset: string, readonly over: AbortSignal, readonly held: (generation: number) => void) {
    over.addEventListener('abort', () => this.#fetcher?.stop());
  }

  /** Rejects where the memory cannot be used: the stream goes on without. */
  async remember({ generation, kept, segments }: Remember): Promise<void> {
    if (this.over.aborted) return;
    const fits = kept <= this.#segments.length && kept + segments.length <= MAX_SEGMENTS;
    const next = [...this.#segments.slice(0, kept), ...segments];
    // What is named again stays: acknowledgements of before a pause may arrive after it, and say that it is here.
    if (!fits || this.#segments.some((id, i) => id !== next[i])) this.#forget();
    if (!fits) throw new EigencastError('corrupt', 'the broker contradicts itself');
    this.#segments = next;
    this.#generation = generation;
    if (!this.#fetcher) await this.#run((this.#fetcher = this.newFetcher()));
  }

  #forget(): void {
    this.#taken = 0;
    this.#fetcher?.stop();
    this.#fetcher = undefined;
    this.frames.forgetMemory();
    this.held(0);
  }
  async #run(fetcher: ObjectFetcher): Promise<void> {
    for (; this.#taken < this.#segments.length; ++this.#taken) {
      const id = this.#segments[this.#taken]!;
      const segment = await fetcher.get({ id, maxBytes: MAX_SEGMENT_BYTES }, (bytes) => this.core.sha256(bytes) === id);
      if (!segment || fetcher.isStopped) return;
      this.frames.remember(this.asset, segment);
    }
    this.#fetcher = undefined;
    this.held(this.#generation);
  }
}
