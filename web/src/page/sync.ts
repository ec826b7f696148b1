// SPDX-License-Identifier: MIT
import type { Broker, Stream } from '../client/client.js';
import { EigencastError } from '../core/module.js';
import type { Playing, Playout } from '../core/playout.js';

// One moment (protocol.md, "moment"): a page shows what all of its group show at the same time. As sdk/receiver.cpp. Loaded for ?sync=GROUP.

const SAY_MS = 250, UNKNOWN = -(2n ** 63n);

/** Throws EigencastError (invalid-argument). */
export function checkedGroup(group: string): string {
  if (/^[a-z0-9._-]{1,32}$/.test(group)) return group;
  throw new EigencastError('invalid-argument', `sync: a group is named by 1 to 32 of a-z 0-9 . _ -, not "${group.slice(0, 64)}"`);
}

/** `playout`, kept to the moment of the stream's group; the broker hears how late this viewer needs it. */
export function inStep(playout: Playout, broker: Pick<Broker, 'onText' | 'sendText'>, stream: Pick<Stream, 'name' | 'status'> & Partial<Pick<Stream, 'info'>>): Playing {
  /** On the broker's clock. */
  let lagUs: number | undefined, saidMs = -Infinity;
  const hear = (text: string): void => {
    if (text === '') lagUs = undefined;  // The connection is new.
    if (!text.includes('"op":"moment"')) return;
    try {
      const { stream: name, lag_us: lag } = JSON.parse(text) as { stream?: unknown; lag_us?: unknown };
      if (name === stream.name && Number.isSafeInteger(lag)) lagUs = lag as number;
    } catch (error) {
      console.warn(`eigencast: from the broker: ${(error as Error).message}`);
    }
  };
  broker.onText.add(hear);
  playout.set({ mode: 'estimate', smoothness: 1 });  // As client/options.cpp.
  const at = playout.at.bind(playout), free = playout.free.bind(playout);
  return Object.assign(playout, {
    at(nowUs: bigint) {
      const clock = stream.info?.rewind ? undefined : stream.status?.clock, nowMs = performance.now();
      const needed = playout.keepLag(lagUs === undefined || !clock ? UNKNOWN : BigInt(lagUs - clock.offsetUs));
      if (clock && needed !== UNKNOWN && nowMs - saidMs > SAY_MS) {
        saidMs = nowMs;
        broker.sendText(JSON.stringify({ op: 'late', stream: stream.name, lag_us: Number(needed) + clock.offsetUs }));
      }
      return at(nowUs);
    },
    free() {
      broker.onText.delete(hear);
      free();
    },
  });
}
