#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""A surface that was never baked goes out with a coarse basis at once, and with all of it once that is there: for a viewer one
continuous stream.

    instant_start_test.py BROKER SENDER CLIENT [-v]
"""
import array
import json
import math
import pathlib
import signal
import subprocess
import sys
import tempfile
import threading
import time
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/support")]
import cases
from websocket_peer import Broker

BROKER = SENDER = CLIENT = None
PATIENCE_S = 240
FIRST_RANK, RANK = 54, 120
AFFINE = 12  # Values of the first columns, 1, x0, y0, z0, which are the same in both bases.


SIDE = 71  # Of a sheet: more vertices than are baked at once.


def pose(t):
    """The sheet, which sways, breathes and waves."""
    points = array.array("f")
    for i in range(SIDE * SIDE):
        x, y = i % SIDE / SIDE, i // SIDE / SIDE
        points.extend((x * (1 + 0.2 * math.sin(t)) + 0.3 * math.cos(t), y, 0.3 * x * y + 0.1 * math.sin(3 * x + t)))
    return points.tobytes()


def mesh():
    rest = array.array("f", pose(0))
    corner = lambda x, y: y * SIDE + x + 1
    quads = [(corner(x, y), corner(x + 1, y), corner(x + 1, y + 1), corner(x, y + 1)) for x in range(SIDE - 1) for y in range(SIDE - 1)]
    return "".join([*(f"v {rest[i]} {rest[i + 1]} {rest[i + 2]}\n" for i in range(0, len(rest), 3)), *(f"f {a} {b} {c}\nf {a} {c} {d}\n" for a, b, c, d in quads)])


def feed(process, poses):
    try:
        while True:
            for one in poses:
                process.stdin.write(one)
    except (BrokenPipeError, ValueError):
        pass


def lines(path):
    return [json.loads(line) for line in path.read_text().splitlines(keepends=True) if line.endswith("\n")] if path.exists() else []


class InstantStart(unittest.TestCase):
    def poses_of(self, *profile):
        """What a viewer received of a stream that it watched from the first key to twenty keys after the change; the sender's report."""
        with tempfile.TemporaryDirectory() as folder, Broker(BROKER) as broker:
            folder, url = pathlib.Path(folder), f"http://127.0.0.1:{broker.port}/live/sheet"
            viewer = subprocess.Popen([CLIENT, url, "--headless", "--frames", "1000000", "--record", folder / "poses", "--cache", folder / "viewer",
                                       *profile])
            (folder / "sheet.obj").write_text(mesh())
            sender = subprocess.Popen([SENDER, "pipe", "--mesh", folder / "sheet.obj", "--to", url, "--cache", "", "--rank", str(RANK), "--rate", "30",
                                       "--json", folder / "report"], stdin=subprocess.PIPE)
            feeder = threading.Thread(target=feed, args=(sender, [pose(math.tau * i / 60) for i in range(60)]))
            feeder.start()
            try:
                deadline = time.monotonic() + PATIENCE_S
                while len([p for p in lines(folder / "poses") if len(p["coefficients"]) == 3 * RANK]) < 60:
                    self.assertLess(time.monotonic(), deadline, "the stream does not change over")
                    self.assertEqual([sender.poll(), viewer.poll()], [None, None])
                    time.sleep(0.1)
            finally:
                for process in (viewer, sender):
                    process.send_signal(signal.SIGTERM)
                    process.wait(60)
                feeder.join()
            return lines(folder / "poses"), json.loads((folder / "report").read_text())

    def check(self, poses, report):
        self.assertEqual(report["reconnects"], 0)
        self.assertEqual(len({p["epoch"] for p in poses}), 2)
        ranks = [len(p["coefficients"]) // 3 for p in poses]
        change = ranks.index(RANK)
        self.assertEqual(set(ranks[:change]), {FIRST_RANK})
        self.assertEqual(set(ranks[change:]), {RANK})
        self.assertGreater(change, 1)
        usual = around = 0
        for i in range(1, len(poses)):
            before, after = poses[i - 1], poses[i]
            self.assertGreaterEqual(after["sequence"], before["sequence"])
            elapsed = (after["capture_us"] - before["capture_us"]) / 1e6
            self.assertGreaterEqual(elapsed, 0)
            if elapsed == 0:  # A join brings the newest key again.
                continue
            speed = max(abs(a - b) for a, b in zip(before["coefficients"][:AFFINE], after["coefficients"][:AFFINE])) / elapsed
            if change <= i < change + 9:
                around = max(around, speed)
            else:
                usual = max(usual, speed)
        self.assertGreater(usual, 0)
        self.assertLessEqual(around, 1.5 * usual, "it jumps")

    def test_keys(self):
        self.check(*self.poses_of("--rate", "raw"))

    def test_made_poses(self):
        self.check(*self.poses_of("--rate", "interpolated"))


if __name__ == "__main__":
    BROKER, SENDER, CLIENT = sys.argv[1:4]
    cases.main(argv=[sys.argv[0], *sys.argv[4:]])
