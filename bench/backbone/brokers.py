#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""The model of scaling.py beside runs of 1, 2 and 3 brokers: the same crowd, split evenly, at brokers that follow one stream.

    EIGENCAST_WSLOAD=FOLDER bench/backbone/brokers.py --broker build/bench/bin/eigencast-broker [--viewers 1200] [--rate 30]

The costs of the model are taken from the run of one broker (a delivery) and from a run with one viewer (a hop); what it says of 2 and 3
brokers is then compared with what they use. All brokers share one core: shares, not speeds, are compared.
"""
import argparse
import contextlib
import shutil
import sys

from edge import Nats, watched
from harness import Server, Tools
from scaling import Costs, Crowd, core_of


def run(tools, brokers, viewers, rate, seconds):
    """Share of a core of each broker, and what each delivers in a second."""
    with contextlib.ExitStack() as stack:
        nats = stack.enter_context(Nats(tools.folder))
        servers = [stack.enter_context(Server(tools, "broker", sockets_writes="epoll", backbone_servers=nats)) for _ in range(brokers)]
        results = watched(servers, servers[0], viewers // brokers, rate, seconds)
        return [r["cpu_pct"] / 100 for r in results], [r["delivered_per_s"] for r in results]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--broker", required=True)
    parser.add_argument("--viewers", type=int, default=1200)
    parser.add_argument("--rate", type=int, default=30)
    parser.add_argument("--seconds", type=int, default=5)
    parser.add_argument("--keep", metavar="FOLDER", help="where the compiled tools are kept for the next time")
    options = parser.parse_args()
    if not shutil.which("nats-server"):
        sys.exit("SKIPPED: no nats-server")
    tools = Tools(options.broker, options.keep)
    one, delivered = run(tools, 1, options.viewers, options.rate, options.seconds)
    few, _ = run(tools, 2, 2, options.rate, options.seconds)
    costs = Costs(cpu_s_per_million=one[0] / delivered[0] * 1e6, hop_us=few[1] / options.rate * 1e6)
    print(f"a delivery costs {costs.cpu_s_per_million:.2f} CPU s per million, a hop {costs.hop_us:.0f} us a key (timers and pings included)")
    print(f"{'brokers':>8} {'measured core each':>32} {'sum':>8} {'model, sum':>12}")
    for brokers in (1, 2, 3):
        shares = one if brokers == 1 else run(tools, brokers, options.viewers, options.rate, options.seconds)[0]
        crowd = Crowd(options.viewers, 1, key_rate=options.rate, k=1)
        model = brokers * core_of(crowd, brokers, costs)
        print(f"{brokers:8} {'  '.join(f'{s:.3f}' for s in shares):>32} {sum(shares):8.3f} {model:12.3f}", flush=True)


if __name__ == "__main__":
    main()
