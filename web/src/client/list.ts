// SPDX-License-Identifier: MIT
import { EigencastError } from '../core/module.js';
import type { ListedStream } from './client.js';
import type { Environment } from './environment.js';
import type * as Refusal from './refusal.js';
import type * as Url from './url.js';

/** What the page has loaded. */
type Loaded = Pick<typeof Url, 'endpoint'> & Pick<typeof Refusal, 'remark'>;
type BrokerUrl = Url.BrokerUrl;

const MAX_LISTED = 100_000;

/** Broker.streams(). */
export async function listedStreams(url: BrokerUrl, environment: Environment, loaded: Loaded): Promise<ListedStream[]> {
  const all: ListedStream[] = [];
  for (let after = ''; all.length < MAX_LISTED;) {
    const page = await pageOf(url, environment, loaded, after);
    for (const one of Array.isArray(page.streams) ? page.streams : []) all.push(listed(one));
    if (typeof page.next !== 'string' || page.next <= after) break;
    after = page.next;
  }
  return all;
}

async function pageOf(url: BrokerUrl, environment: Environment, { endpoint, remark }: Loaded, after: string): Promise<{ streams?: unknown; next?: unknown }> {
  const where = endpoint(url, '/v1/streams', after === '' ? '' : `after=${encodeURIComponent(after)}`, 'http');
  let answer: Response;
  try {
    answer = await environment.fetch(where, { cache: 'no-store' });
  } catch {
    throw new EigencastError('unreachable', `${url.base} cannot be reached`);
  }
  const body: unknown = await answer.json().catch(() => ({}));
  const fields = typeof body === 'object' && body !== null ? (body as Record<string, unknown>) : {};
  if (answer.ok) return fields;
  const said = typeof fields['message'] === 'string' ? `: ${remark(fields['message'])}` : '';
  throw new EigencastError(typeof fields['error'] === 'string' ? remark(fields['error']) : 'refused', `${url.base} answered ${answer.status}${said}`);
}

function listed(one: unknown): ListedStream {
  const fields = (typeof one === 'object' && one !== null ? one : {}) as Record<string, unknown>;
  const text = (name: string): string => (typeof fields[name] === 'string' ? fields[name] : '');
  const number = (name: string): number => (typeof fields[name] === 'number' ? fields[name] : 0);
  return {
    stream: text('stream'), state: text('state') as ListedStream['state'], asset: text('asset'), epoch: number('epoch'), keyRateHz: number('key_rate_hz'),
    subscribers: number('subscribers'),
  };
}
