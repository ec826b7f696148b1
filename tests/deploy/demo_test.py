#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""deploy/demo.sh without a display, on programs that are built: to its end, and ended by Ctrl-C. It leaves no process behind.

    demo_test.py FOLDER-OF-PROGRAMS [-v]
"""
import json
import os
import pathlib
import re
import signal
import subprocess
import sys
import tempfile
import time
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests/support"))
import cases

PROGRAMS = None
PATIENCE_S = 120


def processes_of(session):
    found = []
    for stat in pathlib.Path("/proc").glob("[0-9]*/stat"):
        try:
            name, rest = stat.read_text().rsplit(")", 1)
        except OSError:
            continue  # It has ended meanwhile.
        if int(rest.split()[3]) == session:
            found.append(name)
    return found


class Demo(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory(prefix="eigencast-demo-")
        self.addCleanup(folder.cleanup)
        self.out, self.temporary = pathlib.Path(folder.name, "out"), pathlib.Path(folder.name, "tmp")
        self.temporary.mkdir()

    def start(self, *words):
        # A session of its own, so that Ctrl-C reaches all of its processes and nothing else.
        demo = subprocess.Popen([ROOT / "deploy/demo.sh", "--headless", "--shape", "torus", "--programs", PROGRAMS, "--out", self.out, *words],
                                start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                                env={**os.environ, "TMPDIR": str(self.temporary)})
        self.addCleanup(demo.stdout.close)
        self.addCleanup(lambda: processes_of(demo.pid) and os.killpg(demo.pid, signal.SIGKILL))
        return demo

    def assert_nothing_is_left(self, demo):
        self.assertEqual(processes_of(demo.pid), [])
        self.assertEqual(list(self.temporary.iterdir()), [])

    def test_runs_to_its_end(self):
        demo = self.start("--frames", "4")
        said, _ = demo.communicate(timeout=PATIENCE_S)
        self.assertEqual(demo.returncode, 0, said)
        self.assertEqual(len(list(self.out.glob("frame_*.png"))), 4)
        page = re.search(r", page at (http://127\.0\.0\.1:\d+/)", (self.out / "broker.log").read_text())
        self.assertEqual(re.findall(r"^in a browser: (.*)$", said, re.M), [page[1] + "demo"] if page else [])
        self.assertGreater(json.loads((self.out / "report.json").read_text())["reconstruction"]["keys"]["poses"], 0)
        self.assert_nothing_is_left(demo)

    def test_ctrl_c_ends_all_of_it(self):
        demo = self.start("--frames", "1000000")
        end = time.monotonic() + PATIENCE_S
        while not list(self.out.glob("frame_*.png")):
            self.assertIsNone(demo.poll())
            self.assertLess(time.monotonic(), end)
            time.sleep(0.05)
        os.killpg(demo.pid, signal.SIGINT)
        said, _ = demo.communicate(timeout=PATIENCE_S)
        self.assertEqual(demo.returncode, 130, said)
        self.assert_nothing_is_left(demo)


if __name__ == "__main__":
    PROGRAMS = pathlib.Path(sys.argv.pop(1)).resolve()
    cases.main()
