#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""What more event loops in one broker deliver (server.threads), beside the bare server with as many threads:
docs/performance/broker.md, "More event loops".

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
import subprocess
import sys
import threading
import time
import urllib.request

sys.path[:0] = [str(pathlib.Path(__file__).resolve().parents[2] / "tests/support")]
import payloads
from harness import free_port, wait_for_port
from websocket_peer import BINARY, PING, PONG, TEXT, Broker, Peer, frame

SIZE, SUBPROTOCOL = 600, "eigencast.v2"
WIRE = SIZE + 4  # With the header of a WebSocket frame.


class Sender(threading.Thread):
    """Joins of SIZE bytes at `rate` until `over`."""

    def __init__(self, port, rate, bare):
        super().__init__()
        template, rows = payloads.float_join(SIZE)
        self.template, self.rate, self.sent, self.over = template, rate, 0, False
        if bare:
            self.peer = Peer(port, "/pub")
            return
        body, name = payloads.asset()
        urllib.request.urlopen(urllib.request.Request(f"http://127.0.0.1:{port}/v1/assets/{name}", data=body, method="PUT")).close()
        self.peer = Peer(port, "/v1/publish/s", SUBPROTOCOL)
        self.peer.send(frame(TEXT, payloads.announce(name, rows, "float32", rate=rate).encode()))
        while b'"announced"' not in self.peer.receive()[1]:
            pass

    def run(self):
        start = time.monotonic()
        while not self.over:
            self.sent += 1
            self.peer.send(frame(BINARY, payloads.stamped(self.template, self.sent, 1_000_000 + self.sent * 1000)))
            time.sleep(max(0, start + self.sent / self.rate - time.monotonic()))


class Viewer:
    """Counts the frames that have come, and answers pings, as every reader does."""

    def __init__(self, port, bare):
        self.peer = Peer(port, "/sub") if bare else Peer(port, "/v1/subscribe/s?rate=raw", SUBPROTOCOL)
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


class BareServer:
    """Beside the broker in the tree of preset bench."""

    def __init__(self, broker, threads):
        self.port = free_port()
        program = pathlib.Path(broker).resolve().parent.parent / "bench/bare_server"
        self.process = subprocess.Popen([program, str(self.port), "epoll", str(threads)])
        wait_for_port(self.port, self.process)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.terminate()
        self.process.wait()


def measure(bare, threads, options):
    scratch = bytearray(1 << 20)
    server = (BareServer(options.broker, threads) if bare else
              Broker(options.broker, f"--threads={threads}", f"--sockets-writes={options.writes}"))
    with server as broker:
        sender = Sender(broker.port, options.rate, bare)
        viewers = [Viewer(broker.port, bare) for _ in range(options.viewers)]
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
    kinds = [(bare, threads) for threads in options.threads for bare in (True, False)]
    seen = {kind: [] for kind in kinds}
    for _ in range(options.repeat):
        for kind in kinds:
            seen[kind].append(measure(*kind, options))
    columns = list(seen[kinds[0]][0])
    print(f"  {'threads':16}" + "".join(f"{column:>18}" for column in columns))
    for (bare, threads), runs in seen.items():
        name = f"{'bare' if bare else 'broker'} {threads}"
        for run in runs:
            print(f"  {name:16}" + "".join(f"{run[column]:18.2f}" for column in columns))
        print(f"  {name + ' median':16}" + "".join(f"{statistics.median(run[column] for run in runs):18.2f}" for column in columns), flush=True)


if __name__ == "__main__":
    main()
