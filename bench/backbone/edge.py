#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""What one more hop costs: viewers at a broker that has the sender, beside viewers at one that follows it over NATS.

    bench/backbone/edge.py --broker build/bench/bin/eigencast-broker [--subs 1000] [--rate 30] [--both]

The measured broker has one core to itself; NATS, the sender, the other broker and the load share the other one. --both: two brokers, each
with that many viewers, beside one that has all of them; here both brokers are on the first core. The arrangements take turns; medians.
Skipped, loudly, without nats-server.
"""
import argparse
import collections
import pathlib
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "bench/broker"), str(ROOT / "tests/support")]
import payloads
from harness import LOAD_CPU, SIZE, Server, Tools, free_port, wait_for_port
from websocket_peer import BINARY, TEXT, Peer, frame


CONNECTING_S = 2


class Nats:
    def __init__(self, folder):
        self.port = free_port()
        self.folder = tempfile.mkdtemp(dir=folder)

    def __enter__(self):
        self.process = subprocess.Popen(["taskset", "-c", LOAD_CPU, "nats-server", "-a", "127.0.0.1", "-p", str(self.port), "-js", "-sd",
                                         self.folder], stderr=subprocess.DEVNULL)
        wait_for_port(self.port, self.process)
        return f"nats://127.0.0.1:{self.port}"

    def __exit__(self, *_):
        self.process.terminate()
        self.process.wait()


class Sender(threading.Thread):
    """Sends the template at a steady rate, each frame with the time when it was to leave."""

    def __init__(self, port, tools, rate):
        super().__init__(daemon=True)
        self.template, rows = payloads.float_join(SIZE)
        self.peer = Peer(port, "/v1/publish/s0", "eigencast.v2")
        self.peer.send(frame(TEXT, payloads.announce(tools.asset, rows, "float32", rate=rate).encode()))
        while b'"announced"' not in self.peer.receive()[1]:
            pass
        self.rate, self.over = rate, False
        self.start()

    def run(self):
        began, sequence = time.monotonic(), 0
        while not self.over:
            due = began + sequence / self.rate
            time.sleep(max(0.0, due - time.monotonic()))
            self.peer.send(frame(BINARY, payloads.stamped(self.template, sequence, int(due * 1e6))))
            sequence += 1
        self.peer.sock.close()


def watched(servers, origin, subs, rate, seconds):
    """Figures of fanout_load with `subs` viewers at each of `servers` (one that is named twice has two crowds), while a sender, which begins when
    all are there, sends to `origin`."""
    crowds = [server.viewers(subs, seconds, CONNECTING_S + 1) for server in servers]
    time.sleep(CONNECTING_S)
    sender = Sender(origin.port, origin.tools, rate)
    figures = [crowd() for crowd in crowds]
    sender.over = True
    sender.join()
    return figures


def summary(crowds):
    """Figures of one server from those of its crowds; each of them counts all that the server used, and its own deliveries."""
    return {"cpu_s_per_1M": 1 / sum(1 / crowd["cpu_s_per_1M"] for crowd in crowds), "p50_ms": statistics.mean(crowd["p50_ms"] for crowd in crowds),
            "p99_ms": max(crowd["p99_ms"] for crowd in crowds), "delivered_per_s": sum(crowd["delivered_per_s"] for crowd in crowds)}


def alone(tools, options):
    with Server(tools, "broker", sockets_writes="epoll") as server:
        return {"at the sender's broker": summary(watched([server], server, options.subs, options.rate, options.seconds))}


def followed(tools, options):
    with Nats(tools.folder) as nats:
        with Server(tools, "broker", backbone_servers=nats) as origin, Server(tools, "broker", sockets_writes="epoll",
                                                                             backbone_servers=nats) as edge:
            for task in pathlib.Path(f"/proc/{origin.process.pid}/task").iterdir():
                subprocess.run(["taskset", "-p", "-c", LOAD_CPU, task.name], check=True, capture_output=True)
            return {"one hop over NATS": summary(watched([edge], origin, options.subs, options.rate, options.seconds))}


def one_with_all(tools, options):
    with Server(tools, "broker", sockets_writes="epoll") as server:
        return {"one broker, all viewers": summary(watched([server] * 2, server, options.subs, options.rate, options.seconds))}


def two_with_half(tools, options):
    with Nats(tools.folder) as nats:
        with Server(tools, "broker", sockets_writes="epoll", backbone_servers=nats) as origin, Server(
                tools, "broker", sockets_writes="epoll", backbone_servers=nats) as edge:
            first, second = watched([origin, edge], origin, options.subs, options.rate, options.seconds)
    return {"two: that of the sender": summary([first]), "two: that which follows": summary([second])}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--broker", required=True)
    parser.add_argument("--subs", type=int, default=1000)
    parser.add_argument("--rate", type=int, default=30)
    parser.add_argument("--seconds", type=int, default=4)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--both", action="store_true", help="viewers at two brokers, beside one that has all of them")
    options = parser.parse_args()
    if not shutil.which("nats-server"):
        sys.exit("SKIPPED: no nats-server")
    tools = Tools(options.broker)
    runs = collections.defaultdict(list)
    for _ in range(options.repeat):
        for arrangement in (one_with_all, two_with_half) if options.both else (alone, followed):
            for name, figures in arrangement(tools, options).items():
                runs[name].append(figures)
    columns = ["cpu_s_per_1M", "p50_ms", "p99_ms", "delivered_per_s"]
    print(f"{options.subs} viewers{' a broker' if options.both else ''}, {options.rate} poses/s of {SIZE} bytes, medians of {options.repeat}")
    print(f"  {'':28}" + "".join(f"{column:>16}" for column in columns))
    for name, results in runs.items():
        print(f"  {name:28}" + "".join(f"{statistics.median(r[c] for r in results):16.3f}" for c in columns))
    print("  cpu_s_per_1M of each run:", "; ".join(f"{name}: {', '.join(format(r['cpu_s_per_1M'], '.2f') for r in results)}" for name, results in runs.items()))


if __name__ == "__main__":
    main()
