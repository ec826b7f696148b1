// SPDX-License-Identifier: MIT
import { checkedName } from '../client/url.js';
import type { Camera } from '../view/camera.js';
import type { Vec3 } from '../view/matrix.js';

/** What the page's address says. */
export interface Place {
  /** Of the broker: "https://host/prefix", without a slash at its end. */
  base: string;
  /** Nothing: the list. */
  stream: string;
  /** Profile and token of the stream, for a URL of the client. */
  query: URLSearchParams;
  token: string;
  isEmbedded: boolean;
  /** Which room to be in, and as whom; nothing: in none. */
  room: string;
  person: string;
  eye: Vec3 | undefined;
  target: Vec3 | undefined;
}

const KEPT = 'eigencast token';

/** The token moves from the address bar, where others would see it, to the tab's memory. */
export function placeOf(address: URL, script: string): Place {
  const base = script.replace(/\/v1\/web\/.*$/, ''), query = new URLSearchParams(address.search), hash = new URLSearchParams(address.hash.slice(1));
  const given = hash.get('access_token') ?? query.get('access_token') ?? '';
  const isEmbedded = query.get('embed') === '1';
  const stream = decodeURIComponent(address.href.slice(base.length).replace(/[?#].*$/, '')).replace(/^\/|\/$/g, '');
  const room = query.get('room') ?? '', person = query.get('name') ?? '';
  for (const key of ['access_token', 'embed', 'room', 'name']) query.delete(key);
  return { base, stream, query, token: given || kept(base), isEmbedded, room, person, eye: vector(hash.get('eye')), target: vector(hash.get('target')) };
}
export function hideToken(place: Place): void {
  if (!/access_token=/.test(location.href)) return;
  keepToken(place.base, place.token);
  history.replaceState(null, '', linkOf(place) + (place.isEmbedded ? `${linkOf(place).includes('?') ? '&' : '?'}embed=1` : ''));
}
/** For this tab only. */
export function keepToken(base: string, token: string): void {
  try {
    sessionStorage.setItem(`${KEPT} ${base}`, token);
  } catch {
    // Pages in sandboxes remember nothing.
  }
}
function kept(base: string): string {
  try {
    return sessionStorage.getItem(`${KEPT} ${base}`) ?? '';
  } catch {
    return '';
  }
}

/** What others can open: the stream, its profile, the camera; never a token. */
export function linkOf({ base, stream, query, room }: Place, camera?: Camera): string {
  const all = new URLSearchParams(query);
  if (room !== '') all.set('room', room);
  const said = all.toString(), at = (v: Vec3): string => v.map((x) => Number(x.toPrecision(5))).join(',');
  return `${base}/${stream}${said === '' ? '' : `?${said}`}${camera?.isMoved ? `#eye=${at(camera.position)}&target=${at(camera.target)}` : ''}`;
}
/** Of a stream that somebody names: of this broker, or by its URL; nothing: neither. */
export function pageOf(text: string, base: string): string | undefined {
  try {
    if (!/[:?#]/.test(text)) return `${base}/${checkedName(text)}`;
    const url = new URL(/^\w+:\/\//.test(text) ? text.replace(/^ws/, 'http') : `http://${text}`);
    return /^https?:$/.test(url.protocol) ? url.href : undefined;
  } catch {
    return undefined;
  }
}
function vector(text: string | null): Vec3 | undefined {
  const parts = (text ?? '').split(',').map(Number);
  return parts.length === 3 && parts.every(Number.isFinite) && text !== '' ? (parts as unknown as Vec3) : undefined;
}
