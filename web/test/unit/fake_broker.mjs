// SPDX-License-Identifier: MIT
import { createServer } from 'node:http';

/** Of npm, or Debian's node-ws: Node 18 has no WebSocket. */
export const ws = await import('ws').catch(() => import('/usr/share/nodejs/ws/wrapper.mjs'));

/** Until `condition` returns something that counts as true, which is returned. */
export async function until(condition, what = 'what was waited for', limitMs = 60_000) {
  for (const end = Date.now() + limitMs; Date.now() < end;) {
    const found = await condition();
    if (found) return found;
    await new Promise((resolve) => setTimeout(resolve, 5));
  }
  throw new Error(`${what} did not come within ${limitMs} ms`);
}

/** A port that was free a moment ago. */
export async function freePort() {
  const server = createServer();
  await new Promise((resolve) => server.listen(0, '127.0.0.1', resolve));
  const { port } = server.address();
  await new Promise((resolve) => server.close(resolve));
  return port;
}

/** A broker that does what a test says: HTTP objects by their hash, and a script for each WebSocket. */
export class FakeBroker {
  objects = new Map();
  /** Paths of GET /v1/assets, with their Range. */
  requests = [];
  /** Connections, oldest first: {socket, url, protocol, received: messages of the client}. */
  connections = [];
  /** Called with each new connection. */
  onConnection = () => {};
  /** status and body of upgrades that are refused; nothing: they are taken. */
  refusal = undefined;
  /** Asked before an object is answered: true cuts the answer off after half. */
  breaks = () => false;
  #server = createServer((request, response) => this.#answer(request, response));
  #sockets = new ws.WebSocketServer({ noServer: true, handleProtocols: () => 'eigencast.v2' });

  async start(port = 0) {
    this.#server.on('upgrade', (request, socket, head) => {
      if (this.refusal) {
        const { status, body, headers = '' } = this.refusal;
        socket.end(`HTTP/1.1 ${status} No\r\nContent-Length: ${body.length}\r\nConnection: close\r\n${headers}\r\n${body}`);
        return;
      }
      this.#sockets.handleUpgrade(request, socket, head, (made) => this.#connected(made, request));
    });
    await new Promise((resolve) => this.#server.listen(port, '127.0.0.1', resolve));
    this.port = this.#server.address().port;
    this.url = `http://127.0.0.1:${this.port}`;
    return this;
  }
  async stop() {
    for (const { socket } of this.connections) socket.terminate();
    this.#sockets.close();
    this.#server.closeAllConnections();
    await new Promise((resolve) => this.#server.close(resolve));
  }
  /** The newest connection. */
  get last() {
    return this.connections.at(-1);
  }
  say(message, { socket } = this.last) {
    socket.send(typeof message === 'string' ? message : JSON.stringify(message));
  }
  send(bytes, { socket } = this.last) {
    socket.send(bytes);
  }

  #connected(socket, request) {
    const connection = { socket, url: request.url, protocol: request.headers['sec-websocket-protocol'], received: [] };
    socket.on('message', (data, isBinary) => connection.received.push(isBinary ? data : String(data)));
    this.connections.push(connection);
    this.onConnection(connection);
  }
  #answer(request, response) {
    const id = /^\/v1\/assets\/([0-9a-f]{64})/.exec(request.url)?.[1];
    const range = request.headers.range;
    if (id) this.requests.push({ id, range });
    const object = this.objects.get(id);
    if (this.refusal && request.url.startsWith('/v1/subscribe')) {
      const { status, body, headers = '' } = this.refusal;
      const [name, value] = headers.trim().split(': ');
      response.writeHead(status, name ? { [name]: value } : {}).end(body);
    } else if (!object) {
      response.writeHead(id ? 404 : 426).end('{}');
    } else {
      const [, first = 0, last = ''] = /^bytes=(\d+)-(\d*)$/.exec(range ?? '') ?? [];
      const part = object.subarray(Number(first), last === '' ? undefined : Number(last) + 1);
      response.writeHead(range ? 206 : 200, { 'content-length': part.length });
      if (!this.breaks(id)) return response.end(part);
      response.write(part.subarray(0, part.length >> 1), () => setTimeout(() => response.destroy(), 20));
    }
  }
}

/** What clients in Node are given. */
export const environment = { WebSocket: ws.WebSocket };
