// SPDX-License-Identifier: MIT
import type { FrameHead } from '../core/frames.js';
import { EigencastError } from '../core/module.js';
import { ClockOffset, type ClockEstimate } from './clock_offset.js';
import { readControl, writeControl, type Message, type Remember, type StreamInfo } from './control.js';
import type { Environment } from './environment.js';
import { messageFrom, queryFrom, type Profile } from './profile.js';
import { failureOfClose, failureOfHandshake } from './refusal.js';
import { Retry, tryAgainIn, type Failure } from './retry.js';
import { endpoint, type BrokerUrl } from './url.js';

/** One watched stream of a connection. No call may lead to join() or leave(). */
export interface Listener {
  onOpen(): void;
  /** waitMs: until the next try; 0: none. */
  onDown(why: Failure, waitMs: number): void;
  onInfo(info: StreamInfo): void;
  onMemory(memory: Remember): void;
  /** askAgainInMs: the broker does not give this stream, and is asked again after so long. */
  onError(message: string, askAgainInMs: number | undefined): void;
  onNotice(message: string, framesDropped: number): void;
  onClock(clock: ClockEstimate): void;
  /** What was read of the frame, for the acknowledgement. */
  onFrame(bytes: Uint8Array, nowUs: number): FrameHead | undefined;
}
export interface Request {
  stream: string;
  profile: Profile;
  /** The group that shows the same moment; a URL does not say it. */
  sync?: string | undefined;
  declinedRetryMs?: number | undefined;
}
interface Stream {
  request: Request;
  listener: Listener;
  /** Once the broker has said it on this connection. */
  id?: number | undefined;
  ack?: FrameHead | undefined;
  /** Of the memory that is held, where it is not said yet. */
  generation?: number;
  askAgainAtUs?: number | undefined;
  isPaused?: boolean;
}

/** Of many streams as seldom as brokers allow, which wait for 100 ms more than the round trip. */
const ACK_INTERVAL_US = 33_000, MANY_STREAMS = 8, MANY_ACK_INTERVAL_US = 85_000, PING_INTERVAL_US = 250_000, SILENCE_US = 10_000_000;
const TICK_MS = 40, CONNECT_TIMEOUT_MS = 3000, DECLINED_RETRY_MS = 5000;
export const SUBPROTOCOL = 'eigencast.v2';
const MAX_ACKS = 64, MAX_UNSENT_BYTES = 1 << 20;

/** Of one stream, or of none yet. */
export function subscribeUrl(broker: BrokerUrl, request: Request | undefined, scheme: 'ws' | 'http' = 'ws'): string {
  return endpoint(broker, `/v1/subscribe${request ? `/${request.stream}` : ''}`, request ? queryFrom(request.profile) : '', scheme);
}

/**
 * One connection to a broker, shared by all streams that are watched there; it reconnects by itself and subscribes to
 * all again, as sdk/broker_connection.h. A connection of one stream names it in its URL, which saves a round trip.
 */
export class BrokerConnection {
  readonly #environment: Environment;
  readonly #broker: BrokerUrl;
  readonly #streamIdOf: (frame: Uint8Array) => number | undefined;
  readonly #streams: Stream[] = [];
  readonly #clock = new ClockOffset();
  readonly #retry = new Retry();
  /** What comes of rooms, and moments; nothing: the connection is new. */
  onText: (text: string) => void = () => {};
  #socket: WebSocket | undefined;
  #openedUs: number | undefined;
  #urlStream = '';
  #down: [Failure, number] | undefined;
  #holdOffMs: number | undefined;
  #retryTimer: ReturnType<typeof setTimeout> | undefined;
  #ticker: ReturnType<typeof setInterval> | undefined;
  #lastAckUs = 0;
  #lastPingUs = 0;
  #lastHeardUs = 0;
  #pingId = 0n;

  constructor(environment: Environment, broker: BrokerUrl, streamIdOf: (frame: Uint8Array) => number | undefined) {
    this.#environment = environment;
    this.#broker = broker;
    this.#streamIdOf = streamIdOf;
  }

  /** Throws EigencastError (invalid-argument) where the stream is watched already. */
  join(request: Request, listener: Listener): void {
    if (this.#find(request.stream)) throw new EigencastError('invalid-argument', `${request.stream} is watched already over this connection`);
    const stream: Stream = { request, listener };
    this.#streams.push(stream);
    if (this.#openedUs !== undefined) {
      listener.onOpen();
      const clock = this.#clock.estimate;
      if (clock) listener.onClock(clock);
      this.#subscribe(stream);
      return;
    }
    if (this.#down) listener.onDown(...this.#down);
    this.retryNow();
  }
  /** No call comes afterwards. The last one closes the connection. */
  leave(listener: Listener): void {
    const at = this.#streams.findIndex((stream) => stream.listener === listener);
    if (at < 0) return;
    const [stream] = this.#streams.splice(at, 1);
    if (this.#openedUs !== undefined && stream!.askAgainAtUs === undefined) this.say('unsubscribe', { stream: stream!.request.stream });
    if (this.#streams.length === 0) this.close();
  }
  change(listener: Listener, profile: Profile): void {
    const stream = this.#streams.find((one) => one.listener === listener);
    if (!stream) return;
    stream.request = { ...stream.request, profile };
    if (this.#openedUs !== undefined) this.#subscribe(stream);
  }
  /** Says in an acknowledgement that a memory is held; 0: none. */
  hold(listener: Listener, generation: number): void {
    const stream = this.#streams.find((one) => one.listener === listener);
    if (stream) stream.generation = generation;
  }
  /** No frames come while it is paused; the connection stays. */
  pause(listener: Listener, isPaused: boolean): void {
    const stream = this.#streams.find((one) => one.listener === listener);
    if (!stream || (stream.isPaused ?? false) === isPaused) return;
    stream.isPaused = isPaused;
    if (this.#openedUs === undefined) return;
    if (!isPaused) return this.#subscribe(stream);
    stream.askAgainAtUs = undefined;
    this.say('unsubscribe', { stream: stream.request.stream });
  }
  /** A control message; lost where there is no connection. */
  sendText(text: string): void {
    if (this.#openedUs !== undefined) this.#socket!.send(text);
  }
  /** Connects at once where it waits for its next try. */
  retryNow(): void {
    if (this.#socket) return;
    clearTimeout(this.#retryTimer);
    this.#connect();
  }
  close(): void {
    clearTimeout(this.#retryTimer);
    clearInterval(this.#ticker);
    const socket = this.#socket;
    this.#socket = this.#openedUs = undefined;
    socket?.close(1000);
  }

  get #where(): string {
    return this.#broker.base.replace(/^http/, 'ws');
  }
  get #ackIntervalUs(): number {
    return this.#streams.length > MANY_STREAMS ? MANY_ACK_INTERVAL_US : ACK_INTERVAL_US;
  }
  #find(name: string): Stream | undefined {
    return this.#streams.find((stream) => stream.request.stream === name);
  }

  #connect(): void {
    const [only, another] = this.#streams;
    this.#urlStream = only && !another && !only.isPaused && !only.request.sync ? only.request.stream : '';
    const asked = this.#urlStream === '' ? undefined : only!.request;
    let socket: WebSocket;
    try {
      socket = new this.#environment.WebSocket(subscribeUrl(this.#broker, asked), SUBPROTOCOL);
    } catch (error) {
      // Mixed content: a page of https:// must not open ws://.
      this.#over({ code: 'refused', message: `no WebSocket at ${this.#where}: ${(error as Error).message}`, refused: true }, undefined);
      return;
    }
    socket.binaryType = 'arraybuffer';
    this.#socket = socket;
    const isCurrent = (): boolean => this.#socket === socket;
    const timer = setTimeout(() => {
      if (isCurrent()) this.#end(socket, { code: 'timeout', message: `${this.#where} does not answer` });
    }, CONNECT_TIMEOUT_MS);
    socket.onopen = () => {
      clearTimeout(timer);
      if (isCurrent()) this.#onOpen();
    };
    socket.onmessage = ({ data }: MessageEvent<string | ArrayBuffer>) => {
      if (!isCurrent()) return;
      this.#lastHeardUs = this.#environment.nowUs();
      if (typeof data === 'string') this.#onText(data);
      else this.#onBinary(new Uint8Array(data));
    };
    socket.onerror = () => {};  // What follows is onclose, which says as much.
    socket.onclose = ({ code, reason }) => {
      clearTimeout(timer);
      if (!isCurrent()) return;
      if (this.#openedUs !== undefined) return this.#end(socket, failureOfClose(this.#where, code, reason));
      void failureOfHandshake(this.#environment, subscribeUrl(this.#broker, asked, 'http'), this.#where, this.#broker.token !== '').then((failure) => {
        if (isCurrent()) this.#end(socket, failure);
      });
    };
  }

  #end(socket: WebSocket, failure: Failure): void {
    const openForMs = this.#openedUs === undefined ? undefined : (this.#environment.nowUs() - this.#openedUs) / 1000;
    this.#socket = this.#openedUs = undefined;
    clearInterval(this.#ticker);
    socket.close();
    this.#over(failure, openForMs);
  }

  #over(failure: Failure, openForMs: number | undefined): void {
    const refusedOne = openForMs === undefined && this.#urlStream !== '' && failure.code === 'refused';
    if (refusedOne && this.#streams.length > 1) return this.retryNow();  // That concerns one stream only.
    const holdOff = this.#holdOffMs;
    this.#holdOffMs = undefined;
    const waitMs = this.#retry.after(failure, openForMs, holdOff, this.#environment.random());
    if (waitMs > 0) this.#retryTimer = setTimeout(() => this.retryNow(), waitMs);
    this.#down = refusedOne ? undefined : [failure, waitMs];
    for (const stream of [...this.#streams]) stream.listener.onDown(failure, waitMs);
  }

  #onOpen(): void {
    const now = this.#environment.nowUs();
    this.#openedUs = this.#lastHeardUs = now;
    this.#down = undefined;
    this.#clock.reset();  // It may be another broker.
    this.#lastAckUs = this.#lastPingUs = 0;
    const named = this.#find(this.#urlStream);
    if (this.#urlStream !== '' && (!named || named.isPaused)) this.say('unsubscribe', { stream: this.#urlStream });
    for (const stream of [...this.#streams]) {
      stream.id = stream.ack = stream.askAgainAtUs = undefined;
      stream.listener.onOpen();
      if (stream.request.stream !== this.#urlStream) this.#subscribe(stream);
    }
    this.#ticker = setInterval(() => this.#onTick(), TICK_MS);
    this.onText('');
  }

  #onText(text: string): void {
    if (/"(room":|op":"(moment|history))"/.test(text)) return this.onText(text);  // As a key: in texts quotes are escaped.
    let message: Message | undefined;
    try {
      message = readControl(text);
    } catch (error) {
      console.warn(`eigencast: from the broker: ${(error as Error).message}`);
    }
    if (message) this.#onMessage(message);
  }

  #onMessage(message: Message): void {
    const now = this.#environment.nowUs();
    switch (message.op) {
      case 'stream': {
        const stream = this.#find(message.stream);
        if (!stream) return;
        stream.id = message.stream_id;
        stream.askAgainAtUs = undefined;
        return stream.listener.onInfo(message);
      }
      case 'remember':
        return this.#find(message.stream)?.listener.onMemory(message);
      case 'ping':
        return this.say('pong', { id: message.id, time_us: message.time_us, peer_time_us: now });
      case 'pong': {
        this.#clock.add(Number(message.time_us), message.peer_time_us, now);
        const clock = this.#clock.estimate;
        if (clock) for (const stream of this.#streams) stream.listener.onClock(clock);
        return;
      }
      case 'notice':
        return this.#forEach(message.stream, (stream) => stream.listener.onNotice(message.message, message.frames_dropped));
      case 'error': {
        const declined = message.stream !== '';
        return this.#forEach(message.stream, (stream) => {
          const waitMs = stream.request.declinedRetryMs ?? DECLINED_RETRY_MS;
          if (declined) {
            stream.id = undefined;
            stream.askAgainAtUs = now + 1000 * waitMs;
          }
          stream.listener.onError(`the broker says: ${message.message} (${message.code})${declined ? tryAgainIn(waitMs) : ''}`, declined ? waitMs : undefined);
        });
      }
      case 'bye':
        this.#holdOffMs = message.retry_after_ms;
    }
  }

  #onBinary(bytes: Uint8Array): void {
    const now = this.#environment.nowUs();
    const id = this.#streamIdOf(bytes);
    for (const stream of this.#streams) {
      if (id !== undefined && stream.id !== id) continue;
      // Received is received: also what cannot be decoded no longer fills the link.
      stream.ack = stream.listener.onFrame(bytes, now) ?? stream.ack;
    }
    if (now - this.#lastAckUs >= this.#ackIntervalUs) this.#acknowledge(now);  // Last, so that the pose does not wait for it.
  }

  #onTick(): void {
    const now = this.#environment.nowUs();
    if (now - this.#lastAckUs >= this.#ackIntervalUs) this.#acknowledge(now);
    for (const stream of this.#streams) {
      // The answer, of either kind, says how it goes on.
      if (stream.askAgainAtUs !== undefined && now >= stream.askAgainAtUs) this.#subscribe(stream);
    }
    const unanswered = this.#lastPingUs > this.#lastHeardUs;
    if (unanswered && now - this.#lastHeardUs > SILENCE_US && now - this.#lastPingUs > PING_INTERVAL_US)
      return this.#end(this.#socket!, { code: 'timeout', message: `${this.#where} fell silent` });
    if (now - this.#lastPingUs < PING_INTERVAL_US) return;
    this.#lastPingUs = now;
    this.say('ping', { id: ++this.#pingId, time_us: now });
  }

  #acknowledge(now: number): void {
    const items = [];
    for (const stream of this.#streams) {
      if (!stream.ack) continue;
      const { sequence, at, of } = stream.ack;
      items.push({ stream_id: stream.id ?? stream.ack.streamId, sequence, step: (at << 4) | of, ...(stream.generation ? { generation: stream.generation } : {}) });
      stream.ack = undefined;
      stream.generation = 0;
    }
    if (items.length > 0) this.#lastAckUs = now;
    for (let i = 0; i < items.length; i += MAX_ACKS) this.say('ack', { items: items.slice(i, i + MAX_ACKS), time_us: now });
  }

  #subscribe(stream: Stream): void {
    stream.askAgainAtUs = undefined;
    if (stream.isPaused) return;
    this.say('subscribe', { stream: stream.request.stream, profile: messageFrom(stream.request.profile), ...(stream.request.sync && { sync: stream.request.sync }) });
  }
  /** Lost where there is no connection. A broker that does not read is let go. */
  say(op: string, fields: object): void {
    const socket = this.#socket;
    if (!socket || this.#openedUs === undefined) return;
    if (socket.bufferedAmount > MAX_UNSENT_BYTES) return this.#end(socket, { code: 'timeout', message: `${this.#where} does not read` });
    socket.send(writeControl(op, fields));
  }
  #forEach(nameOrAll: string, call: (stream: Stream) => void): void {
    for (const stream of [...this.#streams]) if (nameOrAll === '' || stream.request.stream === nameOrAll) call(stream);
  }
}
