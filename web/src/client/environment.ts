// SPDX-License-Identifier: MIT

/** What the client asks of its surroundings; tests, and programs in Node, bring their own. */
export interface Environment {
  WebSocket: new (url: string, protocol: string) => WebSocket;
  fetch: (url: string, options?: RequestInit) => Promise<Response>;
  /** Microseconds on a clock that never steps and that page and worker share: an integer. */
  nowUs(): number;
  /** 0 to 1. */
  random(): number;
}

export function surroundings(given: Partial<Environment> = {}): Environment {
  return {
    WebSocket: given.WebSocket ?? globalThis.WebSocket,
    fetch: given.fetch ?? ((url, options) => globalThis.fetch(url, options)),
    nowUs: given.nowUs ?? (() => Math.round((performance.timeOrigin + performance.now()) * 1000)),
    random: given.random ?? Math.random,
  };
}
