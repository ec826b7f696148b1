// SPDX-License-Identifier: MIT
import type { Environment } from './environment.js';
import { HOPELESS_MS, type Failure } from './retry.js';

// Why a connection failed or ended, in the words of common/net/websocket_failure.cpp.

const REPLACED = 4409;
const REFUSING_CODES = [1002, 1003, 1007, 1008];
const MAX_RETRY_AFTER_S = 600;

/** What a peer says, without control characters. */
export function remark(text: string): string {
  return text.slice(0, 600).replace(/[\u0000-\u001f\u007f-\u009f\u2028-\u202e\u2066-\u2069]/g, (c) => `\\u${c.charCodeAt(0).toString(16).padStart(4, '0')}`);
}

export function failureOfClose(where: string, code: number, reason: string): Failure {
  if (code === 1006) return { code: 'disconnected', message: `connection to ${where} lost` };
  const said = remark(reason);
  const refused = REFUSING_CODES.includes(code), replaced = code === REPLACED;
  return {
    code: refused || replaced ? 'refused' : 'disconnected',
    message: `${where} closed the connection (${code}${said === '' ? '' : `, ${said}`})`,
    refused,
    forGood: replaced,
  };
}

/** Browsers do not say why a WebSocket was refused: a plain request of the same address does. */
export async function failureOfHandshake(environment: Environment, url: string, where: string, hasToken: boolean): Promise<Failure> {
  const unreachable = { code: 'unreachable', message: `no WebSocket at ${where}` };
  let answer: Response;
  try {
    answer = await environment.fetch(url, { cache: 'no-store', redirect: 'error', signal: AbortSignal.timeout(3000) });
  } catch {
    // Browsers hide a refusal of foreign pages, too.
    const origin = globalThis.location?.origin;
    const hint = origin === undefined || url.startsWith(`${origin}/`) ? '' : ` from here; if it runs, its setting access.origins must name ${origin}`;
    return { code: 'unreachable', message: `${where} cannot be reached${hint}` };
  }
  if (answer.status === 426 || answer.status >= 500 || answer.status < 400) return unreachable;
  const body = await answer.text().catch(() => '');
  const advice = answer.status !== 401 ? '' : hasToken ? ' (the token that was given does not do)' : ' (give a token)';
  const said = messageIn(body);
  const retryAfterS = Number(answer.headers.get('retry-after') ?? 0);
  const hopeless = answer.status === 401 || answer.status === 403;
  return {
    code: 'refused',
    message: `${where} answered ${answer.status}${said === '' ? '' : `: ${said}`}${advice}`,
    refused: true,
    minWaitMs: Math.max(hopeless ? HOPELESS_MS : 0, 1000 * Math.min(Number.isFinite(retryAfterS) ? retryAfterS : 0, MAX_RETRY_AFTER_S)),
  };
}

function messageIn(body: string): string {
  try {
    const { message } = JSON.parse(body) as { message?: unknown };
    if (typeof message === 'string') return remark(message);
  } catch {
    // Another server's words.
  }
  return remark(body.slice(0, 300));
}
