#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""The model of scaling.py beside runs of 1, 2 and 3 brokers: the same crowd, split evenly, at brokers that follow one stream.

    EIGENCAST_WSLOAD=FOLDER bench/backbone/brokers.py --broker build/bench/bin/eigencast-broker [--viewers 1200] [--rate 30]

The costs of the model are taken from the run of one broker (a delivery) and from a run with one viewer (a hop); what it says of 2 and 3
brokers is then compared with what they use. All brokers share one core: shares, not speeds, are compared.
"""
import argparse
import contextlib
import json
import pathlib
import shutil
import subprocess
import sys
import time

from edge import CONNECTING_S, Nats, Sender
from harness import LOAD_CPU, SIZE, Server, Tools
from scaling import Costs, Crowd, core_of


def viewers_of(server, name, subs, seconds):
    out = server.tools.folder / f"{name}.jsonl"
    out.unlink(missing_ok=True)
    return out, subprocess.Popen(
        ["taskset", "-c", LOAD_CPU, str(server.tools.folder / "wsload"), "--port", str(server.port), "--pid", str(server.process.pid),
         "--no-spin", "--quiet", "--json", str(out), "--no-pub", "--subs", str(subs), "--secs", str(seconds), "--warm",
         str(CONNECTING_S + 1), "--rate", "1", "--size", str(SIZE), "--us", "--magic-off", "-1", "--ts-off", "19", "--seq-off", "11",
         "--find-off", "19", "--find-seq-off", "11", "--path", "/v1/subscribe/s0?rate=raw", "--subproto", "eigencast.v1", "--ready",
         '"waiting"'], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def run(tools, brokers, viewers, rate, seconds):
    """Share of a core of each broker."""
    with contextlib.ExitStack() as stack:
        nats = stack.enter_context(Nats(tools.folder))
        servers = [stack.enter_context(Server(tools, "broker", sockets_writes="epoll", backbone_servers=nats)) for _ in range(brokers)]
        crowds = [viewers_of(server, f"crowd{i}", viewers // brokers, seconds) for i, server in enumerate(servers)]
        time.sleep(CONNECTING_S)
        sender = Sender(servers[0].port, tools, rate)
        results = []
        for out, process in crowds:
            process.wait()
            results.append(json.loads(out.read_text().splitlines()[-1]))
        sender.over = True
        sender.join()
        return [r["cpu_pct"] / 100 for r in results], [r["delivered_per_s"] for r in results]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--broker", required=True)
    parser.add_argument("--viewers", type=int, default=1200)
    parser.add_argument("--rate", type=int, default=30)
    parser.add_argument("--seconds", type=int, default=5)
    options = parser.parse_args()
    if not shutil.which("nats-server"):
        sys.exit("SKIPPED: no nats-server")
    tools = Tools(options.broker)
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
