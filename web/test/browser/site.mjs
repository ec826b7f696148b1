// SPDX-License-Identifier: MIT
import { createReadStream, existsSync, readFileSync } from 'node:fs';
import { createServer, request as httpRequest } from 'node:http';
import { connect } from 'node:net';
import { extname, join } from 'node:path';
import { BUILD } from '../unit/support.mjs';

const TYPES = { '.js': 'text/javascript', '.css': 'text/css', '.html': 'text/html; charset=utf-8', '.wasm': 'application/wasm' };
const POLICY = (host) => [
  "default-src 'none'", "script-src 'self' 'wasm-unsafe-eval'", "style-src 'self'", "img-src 'self' data: blob:", "worker-src 'self'",
  `connect-src 'self' ws://${host}`, "base-uri 'none'", "form-action 'none'",
].join('; ');

/**
 * Serves the page as a broker does: what was built below /v1/web/, the page for all other names, the rest by the broker
 * at `port`, or by nobody. `pages`: documents of a test, by path. `prefix`: as behind a proxy. Without a
 * policy the site is anybody's. `isProxy`: the broker serves all of it. A path in `held` is never answered, but counted.
 */
export async function startSite(port, { pages = {}, prefix = '', hasPolicy = true, isProxy = false } = {}) {
  const held = new Map(), server = createServer((request, response) => {
    const whole = new URL(request.url, 'http://x').pathname, path = whole.slice(prefix.length);
    if (held.has(path)) return void held.set(path, held.get(path) + 1);
    if (!whole.startsWith(prefix)) return response.writeHead(404).end('Not Found');
    const file = join(BUILD, path.replace(/^\/v1\/web\//, ''));
    if (!isProxy && path.startsWith('/v1/web/') && !path.includes('..') && existsSync(file)) {
      response.writeHead(200, { 'content-type': TYPES[extname(file)] ?? 'application/octet-stream', 'access-control-allow-origin': '*' });
      return createReadStream(file).pipe(response);
    }
    if (!isProxy && !path.startsWith('/v1/') && (pages[path] || !/^application\/json$/.test(request.headers.accept))) {
      const up = '../'.repeat(path.split('/').length - 2) || './';
      const html = pages[path] ?? readFileSync(join(BUILD, 'page.html'), 'utf8').replaceAll('{web}', `${up}v1/web/`);
      response.writeHead(200, { 'content-type': TYPES[extname(path)] ?? TYPES['.html'], ...(hasPolicy ? { 'content-security-policy': POLICY(request.headers.host) } : { 'access-control-allow-origin': '*' }) });
      return response.end(html);
    }
    const asked = httpRequest({ port, path: request.url.slice(prefix.length), method: request.method, headers: request.headers }, (answer) => {
      response.writeHead(answer.statusCode, answer.headers);
      answer.pipe(response);
    });
    asked.on('error', () => response.writeHead(502).end());
    request.pipe(asked);
  });
  const sockets = new Set(), counted = { connections: 0, bytesDown: 0, bytesUp: 0 };
  server.on('upgrade', (request, socket, head) => {
    if (!request.url.startsWith(`${prefix}/`)) return socket.end('HTTP/1.1 404 Not Found\r\ncontent-length: 0\r\nconnection: close\r\n\r\n');
    ++counted.connections;
    socket.on('data', (bytes) => (counted.bytesUp += bytes.length));
    const peer = connect(port, '127.0.0.1', () => {
      const lines = request.rawHeaders.flatMap((name, i) => (i % 2 === 0 ? [`${name}: ${request.rawHeaders[i + 1]}`] : []));
      peer.write(`${request.method} ${request.url.slice(prefix.length)} HTTP/1.1\r\n${lines.join('\r\n')}\r\n\r\n`);
      peer.write(head);
      peer.on('data', (bytes) => (counted.bytesDown += bytes.length));
      socket.pipe(peer).pipe(socket);
    });
    sockets.add(socket).add(peer);
    for (const [one, other] of [[socket, peer], [peer, socket]]) one.on('error', () => other.destroy()).on('close', () => other.destroy());
  });
  await new Promise((resolve) => server.listen(0, '127.0.0.1', resolve));
  return {
    url: `http://127.0.0.1:${server.address().port}${prefix}`,
    held,
    /** Of WebSockets, so far. */
    counted,
    /** Cuts every WebSocket, as a network that fails. */
    cut: () => sockets.forEach((socket) => socket.destroy()),
    stop: () => {
      sockets.forEach((socket) => socket.destroy());
      server.closeAllConnections();
      return new Promise((resolve) => server.close(resolve));
    },
  };
}
