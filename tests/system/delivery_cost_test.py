#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Holds what one delivery costs the broker: user instructions (callgrind) and system calls (strace), which no noise moves.

    delivery_cost_test.py BROKER [-v]

Two runs that differ only in the number of poses; the difference over the deliveries between them leaves out starting, joining, ending.
"""
import ctypes
import os
import pathlib
import re
import shutil
import sys
import tempfile
import unittest
import urllib.request

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/support"), str(ROOT / "bench/broker")]
import cases
import payloads
from websocket_peer import BINARY, TEXT, Broker, Peer, frame

BROKER = None
VIEWERS, FEW, MANY, SIZE = 800, 20, 420, 600
MAX_INSTRUCTIONS = 200
# Ticks cost by the second, not by the delivery: they are left out.
CALLGRIND = ["valgrind", "--tool=callgrind", "--toggle-collect=eigencast::broker::Connection::tick()", "--collect-atstart=yes"]
MAX_CALLS = {"epoll": 1.05, "io_uring": 0.05}  # One call of 32 deliveries asks for the peer's window.
SYS_IO_URING_SETUP = 425


def has_io_uring():
    ring = ctypes.CDLL(None).syscall(SYS_IO_URING_SETUP, 1, (ctypes.c_uint32 * 30)())
    if ring >= 0:
        os.close(ring)
    return ring >= 0


def deliver(port, poses):
    """So many poses to all viewers, each waited for by all before the next."""
    template, rows = payloads.float_join(SIZE)
    body, name = payloads.asset()
    urllib.request.urlopen(urllib.request.Request(f"http://127.0.0.1:{port}/v1/assets/{name}", data=body, method="PUT")).close()
    viewers = [Peer(port, "/v1/subscribe/s?rate=raw", "eigencast.v2") for _ in range(VIEWERS)]
    sender = Peer(port, "/v1/publish/s", "eigencast.v2")
    for peer in [sender, *viewers]:
        peer.sock.settimeout(60)
    sender.send(frame(TEXT, payloads.announce(name, rows, "float32").encode()))
    for sequence in range(poses):
        pose = payloads.stamped(template, sequence, 1000 * sequence + 1)
        sender.send(frame(BINARY, pose))
        for viewer in viewers:
            while True:
                opcode, payload = viewer.receive()
                if opcode == BINARY:
                    break
            assert payloads.Chain().read(payload).sequence == payloads.WIDE + sequence, "a pose was dropped"
    for peer in [sender, *viewers]:
        peer.sock.close()


class DeliveryCost(unittest.TestCase):
    def min_per_delivery(self, limit, *how):
        """What a run does by the second, not by the delivery, counts as well: a busy machine is given more tries."""
        for _ in range(6):
            cost = self.per_delivery(*how)
            if cost <= limit:
                break
        self.assertLessEqual(cost, limit)
        return cost

    def per_delivery(self, writes, tool, command, total):
        if not shutil.which(tool):
            self.skipTest(f"no {tool}")
        if writes == "io_uring" and not has_io_uring():
            self.skipTest("no io_uring here")
        totals = []
        with tempfile.TemporaryDirectory(prefix="eigencast-cost-") as folder:
            for poses in (FEW, MANY):
                out = pathlib.Path(folder) / f"{poses}"
                with Broker(BROKER, f"--sockets-writes={writes}", "--timeouts-idle-ms=600000", wrap=command(out)) as broker:
                    deliver(broker.port, poses)
                totals.append(total(out.read_text()))
        return (totals[1] - totals[0]) / ((MANY - FEW) * VIEWERS)

    def check_instructions(self, writes):
        cost = self.min_per_delivery(MAX_INSTRUCTIONS, writes, "valgrind",
                                     lambda out: [*CALLGRIND, f"--callgrind-out-file={out}", "--log-file=/dev/null"],
                                     lambda text: int(re.search(r"^(?:summary|totals): (\d+)", text, re.M).group(1)))
        print(f"{cost:.0f} user instructions per delivery by {writes}")

    def check_calls(self, writes):
        cost = self.min_per_delivery(MAX_CALLS[writes], writes, "strace", lambda out: ["strace", "-f", "-c", "-o", str(out)],
                                     lambda text: int(re.search(r"^100\.00 +\S+ +(?:\d+ +)?(\d+) .*total$", text, re.M).group(1)))
        print(f"{cost:.3f} system calls per delivery by {writes}")

    def test_user_instructions_by_epoll(self):
        self.check_instructions("epoll")

    def test_user_instructions_by_io_uring(self):
        self.check_instructions("io_uring")

    def test_system_calls_by_epoll(self):
        self.check_calls("epoll")

    def test_system_calls_by_io_uring(self):
        self.check_calls("io_uring")


if __name__ == "__main__":
    BROKER = sys.argv.pop(1)
    cases.main()
