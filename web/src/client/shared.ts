// SPDX-License-Identifier: MIT
import { connect, type Broker, type ConnectOptions } from './client.js';
import type { BrokerUrl } from './url.js';

interface Shared {
  broker: Promise<Broker>;
  streams: Set<string>;
}
/** By URL and token, and a number: a connection watches a stream once. */
const brokers = new Map<string, Shared>();

/** A broker's connection that does not watch the stream yet; it ends when the last stream leaves. */
export function shared(where: BrokerUrl, stream: string, options: ConnectOptions = {}): { broker: Promise<Broker>; leave(): void } {
  let number = 0, key = '';
  do key = `${number++} ${where.base} ${where.token}`;
  while (brokers.get(key)?.streams.has(stream));
  const { broker, streams } = brokers.get(key) ?? { broker: connect(where.base, { ...options, token: where.token }), streams: new Set<string>() };
  brokers.set(key, { broker, streams: streams.add(stream) });
  return {
    broker,
    leave: () => {
      streams.delete(stream);
      if (streams.size > 0) return;
      brokers.delete(key);
      void broker.then((one) => one.close(), () => {});
    },
  };
}
