// SPDX-License-Identifier: MIT
import { surroundings } from '../client/environment.js';
import type { ToPage, ToWorker } from '../client/protocol.js';
import { Session } from '../client/session.js';
import { Core } from '../core/module.js';

// The worker of a page: one broker's session, from its first message on.

const port = globalThis as unknown as { onmessage: ((event: MessageEvent<ToWorker>) => void) | null; postMessage(message: ToPage, transfer: Transferable[]): void };
let session: Promise<Session> | undefined;

port.onmessage = ({ data }) => {
  if (data.op === 'begin') {
    session = Core.make(data.module).then((core) => new Session(core, surroundings(), data.broker, (message, transfer) => port.postMessage(message, transfer)));
  }
  void session?.then((one) => one.receive(data));
};
