#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""What more event loops in one broker deliver (server.threads), docs/performance/broker.md, "More event loops".

    bench/broker/threads.py --broker build/bench/bin/eigencast-broker [--viewers 1000] [--rate 360]

One stream is offered to all viewers at more than one loop can write. The viewers share the machine with the broker, so they do as
little as viewers can: every few milliseconds each socket is emptied by one call. Numbers of threads take turns; medians.
"""
import argparse
import os
import pathlib
import resource
import socket
import statistics
import sys
import threading
import time
import urllib.request

sys.path[:0] = [str(pathlib.Path(__file__).resolve().parents[2] / "tests/support")]
import payloads
from websocket_peer import BINARY, PING, PONG, TEXT, Broker, Peer, frame

SIZE, SUBPROTOCOL = 600, "eigencast.v1"
WIRE = SIZE + 4  # With the header of a WebSocket frame.


class Sender(threading.Thread):
    """Joins of SIZE bytes at `rate` until stop()."""

    def __init__(self, port, rate):
        super().__init__()
        body, name = payloads.asset()
        urllib.request.urlopen(urllib.request.Request(f"http://127.0.0.1:{port}/v1/assets/{name}", data=body, method="PUT")).close()
        template, rows = payloads.float_join(SIZE)
        self.template, self.rate, self.sent, self.over = template, rate, 0, False
        self.peer = Peer(port, "/v1/publish/s", SUBPROTOCOL)
        self.peer.send(frame(TEXT, payloads.announce(name, rows, "float32", rate=rate).encode()))
        while b'"announced"' not in self.peer.receive()[1]:
            pass

    def run(self):
        start = time.monotonic()
        while not self.over:
            self.sent += 1
            stamped = self.template[:11] + self.sent.to_bytes(8, "little") + (1_000_000 + self.sent * 1000).to_bytes(8, "little")
            self.peer.send(frame(BINARY, stamped + self.template[27:]))
            time.sleep(max(0, start + self.sent / self.rate - time.monotonic()))


class Viewer:
    """Counts the frames that have come, and answers pings, as every reader does."""

    def __init__(self, port):
        self.peer = Peer(port, "/v1/subscribe/s?rate=raw", SUBPROTOCOL)
        self.peer.sock.setblocking(False)
        self.rest = self.peer.buffer

    def read(self, scratch):
        """How many frames came since the last call."""
        try:
            count = self.peer.sock.recv_into(scratch)
        except BlockingIOError:
            return 0
        if not self.rest and count % WIRE == 0:
            return count // WIRE
        self.rest += bytes(scratch[:count])
        frames = 0
        while len(self.rest) >= 4:
            size = self.rest[1]
            head = 4 if size == 126 else 2
            size = int.from_bytes(self.rest[2:4], "big") if size == 126 else size
            if len(self.rest) < head + size:
                break
            kind, payload, self.rest = self.rest[0] & 15, self.rest[head:head + size], self.rest[head + size:]
            frames += kind == BINARY
            if kind == PING:
                self.peer.sock.send(frame(PONG, payload))
        return frames


def cpu_seconds(pid):
    tasks = f"/proc/{pid}/task"
    return sum(int(pathlib.Path(tasks, task, "schedstat").read_text().split()[0]) for task in os.listdir(tasks)) / 1e9


def measure(program, threads, options):
    scratch = bytearray(1 << 20)
    with Broker(program, f"--threads={threads}", f"--sockets-writes={options.writes}") as broker:
        sender = Sender(broker.port, options.rate)
        viewers = [Viewer(broker.port) for _ in range(options.viewers)]
        sender.start()
        spent, own, delivered, begun, sent = 0, 0, 0, None, 0
        start = time.monotonic()
        while True:
            at = time.monotonic()
            came = sum(viewer.read(scratch) for viewer in viewers)
            if begun is None and at - start > options.warm:
                begun, spent, own, sent = at, cpu_seconds(broker.process.pid), time.process_time(), sender.sent
            elif begun is not None:
                delivered += came
                if at - begun > options.seconds:
                    break
            time.sleep(max(0, at + options.every_ms / 1000 - time.monotonic()))
        took = time.monotonic() - begun
        spent, own, sent = cpu_seconds(broker.process.pid) - spent, time.process_time() - own, sender.sent - sent
        sender.over = True
        sender.join()
        for viewer in viewers:
            viewer.peer.sock.close()
    return {"offered_per_s": sent * options.viewers / took, "delivered_per_s": delivered / took, "cpu_s_per_1M": spent / delivered * 1e6,
            "broker_cores": spent / took, "viewers_cores": own / took}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--broker", required=True)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--viewers", type=int, default=1000)
    parser.add_argument("--rate", type=int, default=360)
    parser.add_argument("--seconds", type=float, default=3)
    parser.add_argument("--warm", type=float, default=1)
    parser.add_argument("--every-ms", type=float, default=10)
    parser.add_argument("--writes", default="auto")
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    seen = {threads: [] for threads in options.threads}
    for _ in range(options.repeat):
        for threads in options.threads:
            seen[threads].append(measure(options.broker, threads, options))
    columns = list(seen[options.threads[0]][0])
    print(f"  {'threads':10}" + "".join(f"{column:>18}" for column in columns))
    for threads, runs in seen.items():
        for run in runs:
            print(f"  {threads:<10}" + "".join(f"{run[column]:18.2f}" for column in columns))
        print(f"  {threads:<4}median" + "".join(f"{statistics.median(run[column] for run in runs):18.2f}" for column in columns), flush=True)


if __name__ == "__main__":
    main()
