#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Native viewers of what a broker keeps: they show the poses of the time that they ask for, as who watched live had them.

    past_viewers_test.py BROKER SENDER CLIENT [-v]
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
from tubes import lines, mesh_of
from websocket_peer import ports_of

BROKER = SENDER = CLIENT = None
PATIENCE_S = 150
FIRST_PAST_EPOCH = 1 << 31
RINGS, SIDES = 12, 8
NO_STREAM = 4  # As client/README.md has it.


def pose(number):
    """A tube that sways; no two poses are the same."""
    t, points = 0.05 * number, array.array("f")
    for i in range(RINGS):
        for j in range(SIDES):
            around, along = math.tau * j / SIDES, i / RINGS
            points.extend((along, 0.2 * math.cos(around) + 0.2 * math.sin(2 * along + t) + 1e-3 * t, 0.2 * math.sin(around)))
    return points.tobytes()


class Past(unittest.TestCase):
    def setUp(self):
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="eigencast-past-"))
        self.processes, self.feeding = [], True

    def tearDown(self):
        self.feeding = False
        for process in reversed(self.processes):
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
            process.wait(60)

    def start(self, *words, **more):
        self.processes.append(subprocess.Popen(list(map(str, words)), **more))
        return self.processes[-1]

    def begin(self, *options):
        """A broker, who sends to it, and who watches live: {sequence: pose}."""
        self.start(BROKER, "--listen=127.0.0.1:0", "--admin-listen=127.0.0.1:0", f"--port-file={self.folder / 'port'}", f"--data-dir={self.folder / 'broker'}",
                   "--log-level=error", "--frames-ladder=false", *options)
        self.url = f"http://127.0.0.1:{ports_of(self.folder / 'port')[0]}/live/tube"
        (self.folder / "tube.obj").write_text(mesh_of(pose(0), SIDES))
        sender = self.start(SENDER, "pipe", "--mesh", self.folder / "tube.obj", "--to", self.url, "--cache", self.folder / "bakes", "--wait", "--rank", "20",
                            "--rate", "30", stdin=subprocess.PIPE)
        threading.Thread(target=self.feed, args=(sender,), daemon=True).start()
        self.live = self.folder / "live"
        self.start(CLIENT, self.url, "--headless", "--size", "16x16", "--rate", "raw", "--wait", PATIENCE_S, "--record", self.live, "--cache", "")

    def feed(self, sender):
        number = 0
        try:
            while self.feeding:
                sender.stdin.write(pose(number))
                sender.stdin.flush()
                number += 1
                time.sleep(1 / 30)
        except (BrokenPipeError, ValueError):
            pass

    def wait_for_live(self, poses):
        deadline = time.monotonic() + PATIENCE_S
        while len(lines(self.live)) < poses:
            self.assertLess(time.monotonic(), deadline, "no poses")
            time.sleep(0.1)

    def watch(self, *options):
        """What a viewer of the past received there, its exit code, what it said, its report."""
        record, report = self.folder / "past", self.folder / "report"
        viewer = self.start(CLIENT, self.url, "--headless", "--size", "64x48", "--rate", "raw", "--wait", PATIENCE_S, "--cache", "", "--record", record, "--json", report,
                            *options, stderr=subprocess.PIPE, text=True)
        said = viewer.communicate(timeout=PATIENCE_S)[1]
        poses = [pose for pose in lines(record) if pose["epoch"] >= FIRST_PAST_EPOCH]
        return poses, viewer.returncode, said, json.loads(report.read_text()) if report.exists() else None

    def watched(self, least, *options):
        """The keys, among those that came live, that at least so many poses are to the bit, and the report. Where the machine starves, newer keys
        overtake others on their way to who watches live: then it is tried again."""
        deadline = time.monotonic() + PATIENCE_S
        while True:
            poses, code, said, report = self.watch(*options)
            self.assertEqual(code, 0, said)
            live = {tuple(pose["coefficients"]): pose for pose in lines(self.live)}
            keys = [live[tuple(pose["coefficients"])] for pose in poses if tuple(pose["coefficients"]) in live]
            if len(keys) >= least:
                return keys, report
            self.assertLess(time.monotonic(), deadline, f"{len(keys)} of {len(poses)} poses came live")

    def test_a_moment_is_the_pose_of_that_time(self):
        self.begin("--history-streams=**")
        self.wait_for_live(150)
        (key,), report = self.watched(1, "--ago", "3", "--speed", "0", "--frames", "1")
        self.assertGreaterEqual(report["shown"]["behind_us"], 2_900_000)
        self.assertEqual(report["seek_us"]["count"], 1)
        # All stamps are of this machine: it was captured, then the broker had it, then who watched.
        steady_us = report["shown"]["at_us"] - (time.time_ns() - time.monotonic_ns()) // 1000
        self.assertLess(key["capture_us"], steady_us + 50_000)
        self.assertLess(steady_us, key["arrival_us"] + 50_000)

    def test_it_goes_on_from_there(self):
        self.begin("--history-streams=**")
        self.wait_for_live(150)
        for speed in ("1", "2"):
            sequences = [key["sequence"] for key in self.watched(10, "--ago", "4", "--speed", speed, "--frames", "20")[0]]
            self.assertEqual(sequences, sorted(set(sequences)))

    def test_who_may_not_is_told_so(self):
        self.begin("--history-streams=**", "--access-anonymous-rewind=nothing")
        poses, code, said, _ = self.watch("--ago", "1", "--frames", "1")
        self.assertEqual((poses, code), ([], NO_STREAM))
        self.assertIn("(refused)", said)

    def test_what_is_not_kept_is_not_there(self):
        self.begin()
        poses, code, said, _ = self.watch("--ago", "1", "--frames", "1")
        self.assertEqual((poses, code), ([], NO_STREAM))
        self.assertIn("(not-found)", said)


if __name__ == "__main__":
    BROKER, SENDER, CLIENT = sys.argv[1:4]
    cases.main(argv=[sys.argv[0], *sys.argv[4:]])
