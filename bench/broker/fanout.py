#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""What a delivery costs the broker, beside a bare server that writes the same bytes: rows of docs/performance/broker.md.

    cmake --preset bench && cmake --build --preset bench
    bench/broker/fanout.py --broker build/bench/bin/eigencast-broker [ROW...]

Servers take turns within a row, so that a machine that drifts drifts for all; medians; ratios to the first server of the row.
"""
import argparse
import pathlib
import statistics
import sys
import threading
import time

import interpolation
from harness import Server, Tools

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "tests/support"))
from websocket_peer import BINARY, Peer

# One thread that writes, on both sides.
BARE, BARE_URING = ("bare", {"mode": "epoll"}), ("bare", {"mode": "uring"})
EPOLL, URING = ("broker", {"threads": 1, "sockets_writes": "epoll"}), ("broker", {"threads": 1, "sockets_writes": "io_uring"})


def name_of(kind, settings):
    return " ".join([kind, *(f"{key.split('_', 1)[-1]}={value}" for key, value in settings.items() if "tls_" not in key)])


def in_turn(tools, servers, repeat, **scenario):
    """Runs every server `repeat` times in turn: the figures of each."""
    seen = {name_of(*server): [] for server in servers}
    for _ in range(repeat):
        for kind, settings in servers:
            with Server(tools, kind, **settings) as server:
                seen[name_of(kind, settings)].append(server.load(**scenario))
    return seen


def compare(tools, servers, repeat, columns, **scenario):
    """Runs every server `repeat` times in turn and prints the medians of `columns`."""
    seen = in_turn(tools, servers, repeat, **scenario)
    print(f"  {'':42}" + "".join(f"{column:>18}" for column in columns) + f"{'ratio':>8}")
    first = None
    for name, runs in seen.items():
        medians = [statistics.median(run[column] for run in runs) for column in columns]
        first = first if first is not None else medians[0]
        ratio = medians[0] / first if first else float("nan")
        print(f"  {name:42}" + "".join(f"{value:18.3f}" for value in medians) + f"{ratio:8.2f}", flush=True)
    return seen


def delivery(tools, repeat):
    compare(tools, [BARE, BARE_URING, EPOLL, URING], repeat, ["cpu_s_per_1M", "p99_ms", "loss_pct"],
            subscribers=1000, rate_hz=90, seconds=3)


def tail(tools, repeat):
    """The p99 of `delivery`, the median of many short runs."""
    compare(tools, [BARE, EPOLL, URING], 4 * repeat, ["p99_ms", "p50_ms"], subscribers=1000, rate_hz=90, seconds=1, warm_s=0.3)


def gathered(tools, repeat):
    servers = [BARE] + [("broker", {"sockets_writes": "epoll", "frames_gather_ms": ms}) for ms in (0, 8, 16)] + [URING]
    compare(tools, servers, repeat, ["cpu_s_per_1M", "p50_ms", "p99_ms", "loss_pct"],
            subscribers=200, rate_hz=30, seconds=4, streams=8, several=True)


def flood(tools, repeat):
    compare(tools, [EPOLL, URING], repeat, ["delivered_per_s", "loss_pct", "p99_ms", "cpu_pct"],
            subscribers=200, rate_hz=375, seconds=4, streams=8, several=True)


def flood_one(tools, repeat):
    compare(tools, [BARE, EPOLL, URING], repeat, ["delivered_per_s", "loss_pct", "p99_ms", "rss_peak_kb"],
            subscribers=1000, rate_hz=600, seconds=4)


def stall(tools, repeat):
    for stalled in (0, 10):
        compare(tools, [BARE, EPOLL, URING], repeat, ["p99_ms", "stale_first_ms", "stale_msgs", "rss_peak_kb", "rss_idle_kb", "loss_pct"],
                subscribers=200, rate_hz=90, seconds=7, stalled=stalled, stall_at_s=2, stall_s=4, receive_buffer=32768)


def many(tools, repeat):
    compare(tools, [BARE, EPOLL, URING], repeat, ["cpu_s_per_1M", "p99_ms", "loss_pct", "connect_s"],
            subscribers=4000, rate_hz=30, seconds=4)


def certificate_of(tools):
    return {"tls_certificate": tools.folder / "cert.pem", "tls_key": tools.folder / "key.pem"}


def over_tls(tools):
    return [("bare", {"mode": "tls"}), ("broker", {"threads": 1, "sockets_writes": "epoll", **certificate_of(tools)})]


def idle(tools, repeat):
    for servers in ([BARE, EPOLL], over_tls(tools)):
        compare(tools, servers, repeat, ["connect_s", "rss_conn_kb"], subscribers=4000, seconds=0.2, warm_s=0, publish=False, tls=servers != [BARE, EPOLL])


def joins(tools, repeat):
    """Connections a second of server CPU, up to the first message; without and with signed tokens, and TLS."""
    certificate = certificate_of(tools)
    kinds = [("bare", "bare", None, {"mode": "epoll"}), ("anonymous", "broker", None, {}), ("HS256", "broker", "HS256", {}),
             ("ES256", "broker", "ES256", {}), ("bare TLS", "bare", None, {"mode": "tls"}), ("HS256 and TLS", "broker", "HS256", certificate)]
    seen = {kind[0]: [] for kind in kinds}
    for _ in range(repeat):
        for name, kind, algorithm, settings in kinds:
            token = tools.token(algorithm) if algorithm else None
            with Server(tools, kind, environment=token.environment if token else {}, **settings) as server:
                before = server.cpu_seconds()
                figures = server.load([f"Authorization: Bearer {token.text}"] if token else [], subscribers=2000, seconds=0.1, warm_s=0,
                                      publish=False, tls="TLS" in name)
                spent = server.cpu_seconds() - before
                seen[name].append((2000 / spent, 2000 / figures["connect_s"]))
    for name, runs in seen.items():
        per_cpu, per_wall = (statistics.median(run[i] for run in runs) for i in (0, 1))
        base = statistics.median(run[0] for run in seen["bare TLS" if "TLS" in name else "bare"])
        print(f"  {name:20} {per_cpu:10.0f} joins per CPU second, {per_wall:8.0f} a second {per_cpu / base:8.2f}", flush=True)
    late_joiners(tools)


def late_joiners(tools):
    """First pose of viewers that come while 1,000 watch."""
    with Server(tools, "broker") as server:
        running = threading.Thread(target=server.load, kwargs={"subscribers": 1000, "rate_hz": 30, "seconds": 5})
        running.start()
        time.sleep(3)
        took = []
        while running.is_alive() and len(took) < 40:
            start = time.monotonic()
            viewer = Peer(server.port, "/v1/subscribe/s0?rate=raw", "eigencast.v2")
            while viewer.receive()[0] != BINARY:
                pass
            took.append(1000 * (time.monotonic() - start))
            viewer.sock.close()
            time.sleep(0.03)
        running.join()
    print(f"  late joiners: first pose after {statistics.median(took):.1f} ms (median), {max(took):.1f} ms (most) of {len(took)}")


def peers(tools, repeat):
    compare(tools, [BARE, EPOLL, ("mosquitto", {}), ("nats", {})], repeat, ["cpu_s_per_1M", "p99_ms", "loss_pct", "rss_conn_kb"],
            subscribers=1000, rate_hz=90, seconds=3)


def tls(tools, repeat):
    compare(tools, over_tls(tools), repeat, ["cpu_s_per_1M", "p99_ms", "loss_pct", "rss_conn_kb", "connect_s"],
            subscribers=1000, rate_hz=30, seconds=4, tls=True)


ROWS = {row.__name__: row for row in (delivery, tail, gathered, flood, flood_one, stall, many, idle, tls, joins, peers)}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--broker", required=True)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("rows", nargs="*", metavar="ROW", help=", ".join([*ROWS, "interpolated"]))
    options = parser.parse_args()
    tools = Tools(options.broker)
    for row in options.rows or [*ROWS, "interpolated"]:
        start = time.monotonic()
        print(f"{row}:", flush=True)
        if row == "interpolated":
            interpolation.run(tools, options.repeat)
        elif row in ROWS:
            ROWS[row](tools, options.repeat)
        else:
            sys.exit(f"no row {row}: {', '.join(ROWS)}")
        print(f"  ({time.monotonic() - start:.0f} s)", flush=True)


if __name__ == "__main__":
    main()
