// SPDX-License-Identifier: MIT
import { EigencastError } from '../core/module.js';
import type { Environment } from './environment.js';

/** Where a broker is: an origin and, behind proxies, a path before /v1. */
export interface BrokerUrl {
  /** "https://host:port/prefix", without a slash at its end. */
  base: string;
  token: string;
}

const MAX_URL_BYTES = 12 * 1024;
const DEFAULT_PORT = 7490;

function parsed(text: string): URL {
  const refuse = (why: string): never => {
    throw new EigencastError('invalid-argument', `the URL "${text.slice(0, 200)}" cannot be used: ${why}`);
  };
  if (text.length > MAX_URL_BYTES) refuse('it is longer than 12 KiB');
  // A name without a scheme is a broker's, a URL without a port everybody's.
  const whole = /^[a-z][a-z0-9+.-]*:\/\//i.test(text) ? text : `ws://${text.replace(/^([^/?:[\]]+|\[[^\]]*\])(?=[/?]|$)/, `$1:${DEFAULT_PORT}`)}`;
  let url: URL;
  try {
    url = new URL(whole);
  } catch {
    return refuse('it is not a URL');
  }
  if (!/^(ws|wss|http|https):$/.test(url.protocol)) refuse('it must begin with https://, http://, wss:// or ws://');
  if (url.username !== '' || url.password !== '') refuse('it names a user; give a token instead');
  url.protocol = url.protocol.replace('ws', 'http');
  return url;
}

/** A broker's URL, as http(s)://, ws(s):// or HOST[:PORT]. Throws EigencastError (invalid-argument). */
export function brokerUrl(text: string, token = ''): BrokerUrl {
  const url = parsed(text);
  const path = url.pathname.replace(/\/v1(\/.*)?$/, '').replace(/\/+$/, '');
  return { base: url.origin + path, token: token || (url.searchParams.get('access_token') ?? '') };
}

export interface StreamUrl {
  broker: BrokerUrl;
  stream: string;
  /** Which profile. */
  query: URLSearchParams;
}

/** A stream's URL, taken apart. `prefix`: the path before the name. Throws EigencastError (invalid-argument). */
export function streamUrl(text: string, token = '', prefix = ''): StreamUrl {
  const url = parsed(text);
  const [, before, name] = /^(.*)\/v1\/subscribe\/(.+)$/.exec(url.pathname) ?? [
    '', prefix, url.pathname.startsWith(`${prefix}/`) ? url.pathname.slice(prefix.length + 1) : url.pathname.slice(1),
  ];
  const query = new URLSearchParams(url.search);
  const broker = { base: url.origin + (before ?? ''), token: token || (query.get('access_token') ?? '') };
  query.delete('access_token');
  return { broker, stream: checkedName(decodeURIComponent(name ?? '').replace(/\/+$/, '')), query };
}

/** The same where a proxy may have put a path in front: the URL itself says where its endpoints are (protocol.md, section 9). */
export async function locatedUrl(text: string, token: string | undefined, { fetch }: Environment): Promise<StreamUrl> {
  const direct = streamUrl(text, token), url = parsed(text), asked = url.origin + url.pathname;
  if (!direct.stream.includes('/') || url.pathname.includes('/v1/')) return direct;
  try {
    const answer = await fetch(asked, { headers: { accept: 'application/json' }, signal: AbortSignal.timeout(3000) });
    const { subscribe } = (await answer.json()) as { subscribe?: unknown };
    const found = new URL(String(subscribe), asked);
    if (typeof subscribe === 'string' && found.origin === url.origin && found.pathname.includes('/v1/subscribe/')) return streamUrl(found.href + url.search, token);
  } catch {
    // An older broker, or none: the connection says why.
  }
  return direct;
}

/** Throws EigencastError (invalid-argument) where it is not a stream's name (protocol.md, section 2). */
export function checkedName(name: string): string {
  const good = name.length <= 128 && !name.startsWith('v1/') && name.split('/').every((part) => /^[A-Za-z0-9._-]+$/.test(part) && part !== '.' && part !== '..');
  if (good) return name;
  throw new EigencastError('invalid-argument',
    `stream name "${name.slice(0, 128)}": segments of A-Z a-z 0-9 . _ - joined by single '/', at most 128 bytes, such as lab/horse`);
}

/** For WebSockets and requests of a broker; the token goes into the query, where browsers can put it. */
export function endpoint(broker: BrokerUrl, path: string, query: string, scheme: 'http' | 'ws'): string {
  const token = broker.token === '' ? '' : `access_token=${encodeURIComponent(broker.token)}`;
  const all = [query, token].filter((part) => part !== '').join('&');
  return broker.base.replace(/^http/, scheme) + path + (all === '' ? '' : `?${all}`);
}
