// SPDX-License-Identifier: MIT
import { subscribeUrl, SUBPROTOCOL } from '../client/connection.js';
import { surroundings, type Environment } from '../client/environment.js';
import type { ToPage } from '../client/protocol.js';
import { Session } from '../client/session.js';
import type { BrokerUrl } from '../client/url.js';
import { Core } from '../core/module.js';
import type { FromPlayer } from '../recording/worker.js';

// The worker of a page: one broker's session, from its first message on, or a recording's. Its socket opens while the core
// is on its way.

const MAX_HEARD = 256;

const port = globalThis as unknown as { onmessage: ((event: Pick<MessageEvent<FromPlayer>, 'data'>) => void) | null; postMessage(message: ToPage, transfer: Transferable[]): void };
const environment = surroundings(), waiting: Exclude<FromPlayer, { op: 'open' | 'read' }>[] = [];
let broker: BrokerUrl | undefined, session: Promise<Session> | undefined;

port.onmessage = ({ data }) => {
  if (data.op === 'open' || data.op === 'read') {
    void import('../recording/worker.js').then(() => port.onmessage!({ data }));  // It listens from now on.
  } else if (data.op === 'core') {
    session = Core.make(data.module).then((core) => {
      const made = new Session(core, environment, broker!, (message, transfer) => port.postMessage(message, transfer));
      for (const message of waiting) made.receive(message);
      return made;
    });
  } else if (session) {
    void session.then((one) => one.receive(data));
  } else {
    if (data.op === 'begin') broker = data.broker;
    if (data.op === 'watch' && waiting.length === 1) environment.WebSocket = opened(subscribeUrl(broker!, data), environment.WebSocket);
    waiting.push(data);
  }
};

/** Who asks for a socket to `url` gets, once, one that is open or about to be, and hears what it has said. */
function opened(url: string, Socket: Environment['WebSocket']): Environment['WebSocket'] {
  let socket: WebSocket | undefined;
  const heard: Event[] = [];
  const hear = (event: Event): void => {
    if (heard.push(event) > MAX_HEARD) socket?.close();
  };
  try {
    socket = new Socket(url, SUBPROTOCOL);
    socket.binaryType = 'arraybuffer';
    [socket.onopen, socket.onmessage, socket.onclose] = [hear, hear, hear];
  } catch {
    // It says why to who asks for it.
  }
  return function (asked: string, protocol: string) {
    const made = socket;
    socket = undefined;
    if (!made || asked !== url) {
      made?.close();
      return new Socket(asked, protocol);
    }
    queueMicrotask(() => {
      for (const event of heard) (made[`on${event.type}` as 'onopen'] as (event: Event) => void)(event);
    });
    return made;
  } as unknown as Environment['WebSocket'];
}
