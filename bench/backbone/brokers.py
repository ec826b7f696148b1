#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""The model of scaling.py beside runs of 1, 2 and 3 brokers: the same crowd, split evenly, at brokers that follow one stream.

    bench/backbone/brokers.py --broker build/bench/bin/eigencast-broker [--viewers 1200] [--rate 30]

The costs of the model are measured apart: a broker with nothing to do, one that follows for a single viewer (a hop), and one with half of
the crowd, in as many processes of the load (a delivery). What it says of all viewers at 1, 2 and 3 brokers is then compared with what they
use. The load is the same in all runs: one process for each sixth of the crowd. All brokers share one core: shares, not speeds, are
compared. The runs take turns; medians.
"""
import argparse
import contextlib
import shutil
import statistics
import sys
import time

from edge import Nats, watched
from harness import Server, Tools
from scaling import Costs, Crowd, core_of

CROWDS = 6


class Bench:
    def __init__(self, options):
        self.options = options
        self.tools = Tools(options.broker)

    @contextlib.contextmanager
    def brokers(self, count):
        with contextlib.ExitStack() as stack:
            nats = stack.enter_context(Nats(self.tools.folder))
            yield [stack.enter_context(Server(self.tools, "broker", sockets_writes="epoll", backbone_servers=nats)) for _ in range(count)]

    def shares(self, count, crowds, viewers):
        """Of a core, of each of `count` brokers, with `crowds` of `viewers` each spread over them."""
        with self.brokers(count) as servers:
            at = [servers[crowd % count] for crowd in range(crowds)]
            figures = watched(at, servers[0], viewers, self.options.rate, self.options.seconds)
            return [statistics.mean(f["cpu_pct"] for f, server in zip(figures, at) if server is one) / 100 for one in servers]

    def idle(self):
        with self.brokers(1) as (server,):
            time.sleep(1)
            before = server.cpu_seconds()
            time.sleep(2)
            return (server.cpu_seconds() - before) / 2


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--broker", required=True)
    parser.add_argument("--viewers", type=int, default=1200)
    parser.add_argument("--rate", type=int, default=30)
    parser.add_argument("--seconds", type=int, default=3)
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    if not shutil.which("nats-server"):
        sys.exit("SKIPPED: no nats-server")
    bench = Bench(options)
    each = options.viewers // CROWDS
    half, runs = [], {1: [], 2: [], 3: []}
    idle, hop = bench.idle(), bench.shares(2, 2, 1)[1]
    for _ in range(options.repeat):
        half.append(bench.shares(1, CROWDS, each // 2)[0])
        for brokers, results in runs.items():
            results.append(bench.shares(brokers, CROWDS, each))
    per_second = CROWDS * (each // 2) * options.rate
    costs = Costs(cpu_s_per_million=(statistics.median(half) - hop) / per_second * 1e6, hop_us=(hop - idle) / options.rate * 1e6, idle_core=idle)
    print(f"a delivery costs {costs.cpu_s_per_million:.2f} CPU s per million, a hop {costs.hop_us:.0f} us a key, a broker by itself {idle:.4f} of a core")
    print(f"{'brokers':>8} {'measured core each':>24} {'sum':>8} {'model':>8} {'error':>7}   sums of all runs")
    for brokers, results in runs.items():
        shares = [statistics.median(column) for column in zip(*results)]
        measured = statistics.median(sum(result) for result in results)
        model = brokers * core_of(Crowd(each * CROWDS, 1, key_rate=options.rate, k=1), brokers, costs)
        print(f"{brokers:8} {'  '.join(f'{s:.3f}' for s in shares):>24} {measured:8.3f} {model:8.3f} {model / measured - 1:+7.1%}   "
              + ", ".join(f"{sum(result):.3f}" for result in results), flush=True)


if __name__ == "__main__":
    main()
