// SPDX-License-Identifier: MIT
import { surroundings } from '../client/environment.js';
import type { ToWorker } from '../client/protocol.js';
import { Core } from '../core/module.js';
import { RecordingReader, sourceOf } from './reader.js';
import { RecordedSession, type ToPlayer } from './session.js';

// The worker of a page that plays a recording, and what such a page's worker becomes.

export type FromPlayer = ToWorker | { op: 'open'; what: Blob | string; module: WebAssembly.Module } | { op: 'read'; fromUs: number; untilUs: number; seek: number };

const port = globalThis as unknown as { onmessage: ((event: MessageEvent<FromPlayer>) => void) | null; postMessage(message: ToPlayer, transfer?: Transferable[]): void };
let session: RecordedSession | undefined;

async function open(what: Blob | string, module: WebAssembly.Module): Promise<void> {
  const [reader, core] = await Promise.all([sourceOf(what).then(RecordingReader.open), Core.make(module)]);
  session = new RecordedSession(core, surroundings(), reader, (message, transfer) => port.postMessage(message, transfer));
  port.postMessage({ op: 'opened', stream: reader.stream, startedMs: reader.startedMs, durationUs: reader.durationUs });
}

port.onmessage = ({ data }) => {
  if (data.op === 'open') open(data.what, data.module).catch((error: Error) => port.postMessage({ op: 'failed', key: 0, code: 'corrupt', message: error.message }));
  else if (data.op === 'read') void session?.stream?.read(data, (op) => port.postMessage({ ...data, op }));
  else session?.receive(data);
};
