#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Holds what one delivery costs the broker: user instructions (callgrind) and system calls (strace), which no noise moves.

    delivery_cost_test.py BROKER [-v]

Two runs that differ only in the number of poses; the difference over the deliveries between them leaves out starting, joining, ending.
"""
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
VIEWERS, FEW, MANY, SIZE = 800, 20, 120, 600
MAX_INSTRUCTIONS, MAX_CALLS = 300, 1.05


def deliver(port, poses):
    """So many poses to all viewers, each waited for by all before the next."""
    template, rows = payloads.float_join(SIZE)
    body, name = payloads.asset()
    urllib.request.urlopen(urllib.request.Request(f"http://127.0.0.1:{port}/v1/assets/{name}", data=body, method="PUT")).close()
    viewers = [Peer(port, "/v1/subscribe/s?rate=raw", "eigencast.v1") for _ in range(VIEWERS)]
    sender = Peer(port, "/v1/publish/s", "eigencast.v1")
    for peer in [sender, *viewers]:
        peer.sock.settimeout(60)
    sender.send(frame(TEXT, payloads.announce(name, rows, "float32").encode()))
    for sequence in range(poses):
        pose = template[:11] + sequence.to_bytes(8, "little") + (1000 * sequence + 1).to_bytes(8, "little") + template[27:]
        sender.send(frame(BINARY, pose))
        for viewer in viewers:
            while True:
                opcode, payload = viewer.receive()
                if opcode == BINARY:
                    break
            assert payload[11:19] == pose[11:19], "a pose was skipped"
    for peer in [sender, *viewers]:
        peer.sock.close()


class DeliveryCost(unittest.TestCase):
    def min_per_delivery(self, limit, *how):
        """Each second that a run takes costs every connection something as well: a busy machine is given two more tries."""
        for _ in range(3):
            cost = self.per_delivery(*how)
            if cost <= limit:
                break
        self.assertLessEqual(cost, limit)
        return cost

    def per_delivery(self, tool, command, total):
        if not shutil.which(tool):
            self.skipTest(f"no {tool}")
        totals = []
        with tempfile.TemporaryDirectory(prefix="eigencast-cost-") as folder:
            for poses in (FEW, MANY):
                out = pathlib.Path(folder) / f"{poses}"
                with Broker(BROKER, "--sockets-writes=epoll", "--timeouts-idle-ms=600000", wrap=command(out)) as broker:
                    deliver(broker.port, poses)
                totals.append(total(out.read_text()))
        return (totals[1] - totals[0]) / ((MANY - FEW) * VIEWERS)

    def test_user_instructions(self):
        cost = self.min_per_delivery(MAX_INSTRUCTIONS, "valgrind",
                                       lambda out: ["valgrind", "--tool=callgrind", f"--callgrind-out-file={out}", "--log-file=/dev/null"],
                                       lambda text: int(re.search(r"^(?:summary|totals): (\d+)", text, re.M).group(1)))
        print(f"{cost:.0f} user instructions per delivery")

    def test_system_calls(self):
        cost = self.min_per_delivery(MAX_CALLS, "strace", lambda out: ["strace", "-f", "-c", "-o", str(out)],
                                       lambda text: int(re.search(r"^100\.00 +\S+ +(?:\d+ +)?(\d+) .*total$", text, re.M).group(1)))
        print(f"{cost:.3f} system calls per delivery")


if __name__ == "__main__":
    BROKER = sys.argv.pop(1)
    cases.main()
