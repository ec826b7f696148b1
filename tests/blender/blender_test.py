#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""The add-on in the real Blender, installed from its zip: what it sends a viewer receives, in order; what it skips it says.

Usage: blender_test.py BROKER LIBRARY SOURCE_FOLDER [-v] [CASE]; the case AddOn.measure prints what a pose costs, for docs/hosts.md.
Without Blender it fails: deploy/install-packages.sh full installs it.
"""
import contextlib
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import unittest

import numpy

BROKER, os.environ["EIGENCAST_LIBRARY"], ROOT = sys.argv[1], sys.argv[2], pathlib.Path(sys.argv[3])
sys.dont_write_bytecode = True
sys.path[:0] = [str(ROOT / "sdk/python"), str(ROOT / "tests/support")]
import cases  # noqa: E402
import eigencast  # noqa: E402

HERE = pathlib.Path(__file__).resolve().parent


class Viewer(threading.Thread):
    """Keeps every pose of a stream, and tells Blender how many have come: FOLDER/arrived, (poses, vertices of the last)."""

    def __init__(self, url, folder):
        super().__init__()
        self.poses, self.arrived, self.ended = [], numpy.memmap(folder / "arrived", numpy.uint64, "w+", shape=2), False
        self.url = url

    def run(self):
        with eigencast.Subscriber(self.url + "?rate=raw", cache_dir="") as subscriber:
            while not self.ended:
                pose = subscriber.next(timeout=0.05)
                if pose is None and len(self.poses) == 1:
                    with contextlib.suppress(eigencast.Error):  # Between two surfaces there is none.
                        pose = subscriber._pose()  # Its detail may have come meanwhile.
                if pose is None:
                    continue
                if self.poses and pose.capture_us == self.poses[-1].capture_us:
                    self.poses[-1] = pose  # The same, in more detail.
                else:
                    self.poses.append(pose)
                self.arrived[:] = len(self.poses), len(pose.positions)


class AddOn(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        if not shutil.which("blender"):
            raise AssertionError("Blender is not installed: deploy/install-packages.sh full")
        cls.folder_keeper = tempfile.TemporaryDirectory()
        cls.folder = pathlib.Path(cls.folder_keeper.name)
        cls.zip = cls.folder / "eigencast-blender.zip"
        subprocess.run([sys.executable, ROOT / "tools/blender/pack.py", cls.zip], check=True)
        cls.start_broker("127.0.0.1:0")
        cls.origin = "http://" + cls.address

    @classmethod
    def start_broker(cls, address):
        port = cls.folder / "port"
        port.unlink(missing_ok=True)
        cls.broker = subprocess.Popen([BROKER, "--listen", address, "--admin-listen", "127.0.0.1:0", "--port-file", port, "--data-dir",
                                       cls.folder / "assets"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        end = time.monotonic() + 60
        while not port.exists() or not port.read_text().endswith("\n"):
            if time.monotonic() > end:
                raise RuntimeError("the broker did not start")
            time.sleep(0.02)
        cls.address = "127.0.0.1:" + port.read_text().split()[0]

    @classmethod
    def tearDownClass(cls):
        cls.broker.terminate()
        cls.broker.wait()
        cls.folder_keeper.cleanup()

    def run_in_blender(self, scenario, before=("blender", "-b")):
        """What it says, and the poses that a viewer of `moves` received."""
        name = scenario.replace(":", "-")
        folder, origin = self.folder / name, f"{self.origin}/{name}"
        folder.mkdir()
        viewer = Viewer(f"{origin}/moves", folder)
        viewer.start()
        try:
            done = subprocess.run([*before, "--factory-startup", "--python-exit-code", "3", "--python", HERE / "in_blender.py", "--", self.zip, scenario,
                                   origin, folder], env={**os.environ, "HOME": str(folder), "EIGENCAST_CACHE": str(self.folder / "bakes"),
                                                         "LIBGL_ALWAYS_SOFTWARE": "1"},
                                  stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=300)
        finally:
            viewer.ended = True
            viewer.join()
        self.assertEqual(done.returncode, 0, done.stdout[-4000:])
        self.assertTrue((folder / "result.json").exists(), done.stdout[-4000:])
        self.assertNotIn("Traceback", done.stdout)
        result = json.loads((folder / "result.json").read_text())
        self.assertNotIn("arning", result["said"])
        sent = folder / "moves.npy"
        return result, numpy.load(sent) if sent.exists() else None, viewer.poses

    def assert_all_came(self, result, sent, came, error=0.002):
        """Each one that was sent, in order, and nothing else."""
        self.assertEqual((result["early"], result["superseded"], result["dropped"]), (0, 0, 0), result)
        self.assertEqual((result["taken"], result["sent"], len(came)), (len(sent),) * 3, result)
        diagonal = numpy.linalg.norm(numpy.ptp(sent[0], axis=0))
        off = [numpy.sqrt(((pose.in_source_order() - points) ** 2).sum(axis=1).mean()) / diagonal for pose, points in zip(came, sent)]
        moved = numpy.linalg.norm(sent[-1] - sent[0], axis=1).max() / diagonal
        self.assertLess(max(off), error)
        self.assertGreater(moved, 0.1)
        self.assertEqual([pose.capture_us for pose in came], sorted({pose.capture_us for pose in came}))
        print(f"  {len(sent)} sent, {len(came)} received; largest rms error {max(off):.1e}, movement {moved:.2f} of the diagonal")

    def test_every_pose_of_every_kind_of_movement_arrives(self):
        for kind in ("shape_key", "soft_body", "cloth", "armature", "geometry_nodes", "text"):
            with self.subTest(kind=kind):
                self.assert_all_came(*self.run_in_blender(f"moves:{kind}"))

    def measure(self):
        for side in (44, 99, 199):
            result, _, came = self.run_in_blender(f"measure:{side}")
            print(f"{result['points']} points | {result['ms']:.2f} ms a pose | sent {result['sent']}, dropped {result['dropped']} | came {len(came)}")

    def test_other_faces_in_each_frame_are_one_sender_and_told(self):
        result, sent, came = self.run_in_blender("remesh")
        self.assertGreater(result["faces"], 10)
        self.assertEqual(result["taken"], result["sent"] + result["early"] + result["superseded"] + result["dropped"])
        self.assertEqual(len(came[-1].positions), len(sent[0]))
        self.assertLess(numpy.abs(came[-1].in_source_order() - sent[0]).max(), 0.2)
        self.assertIn("topology", result["raises"]["skipped"])
        self.assertEqual(result["raises"]["skipped_poses"], 1)

    def test_other_faces_of_as_many_points_are_another_surface(self):
        result, _, came = self.run_in_blender("other_faces")
        self.assertEqual((result["bakes"], result["dropped"]), (2, 0))
        self.assertGreaterEqual(len(came), 2)

    def test_it_follows_an_object_renamed_and_undone_and_ends_with_it(self):
        result, sent, came = self.run_in_blender("life")
        self.assert_all_came({**result["shown"], "taken": result["deleted"]["taken"], "sent": result["deleted"]["sent"]}, sent, came)
        self.assertEqual(result["undone"]["name"], "Another")
        self.assertEqual(result["undone"]["ended"], "")
        self.assertIn("hidden", result["hidden"]["skipped"])
        self.assertEqual(result["shown"]["skipped"], "")
        for end in ("deleted", "removed"):
            self.assertIn("deleted", result[end]["ended"])

    def test_another_file_ends_streams_with_a_reason_and_new_ones_go_on(self):
        result, sent, came = self.run_in_blender("load")
        self.assertIn("file", result["first"]["ended"])
        self.assert_all_came(result, sent, came)

    def test_what_cannot_be_streamed_is_said(self):
        result, _, _ = self.run_in_blender("refusals")
        self.assertIn("another object", result["problems"]["two"])
        self.assertIn("no name", result["problems"]["name"])
        self.assertIn("faces", result["wire"]["skipped"])
        self.assertEqual(result["urls"], ["/Grid", "/Grid.001"])
        self.assertEqual(result["nobody"]["sent"], 0)
        self.assertIn("127.0.0.1:9", result["nobody"]["state"][1])
        self.assertEqual(result["left"], [])

    def test_what_stands_still_is_sent_again_to_a_broker_that_was_away(self):
        folder, seen = self.folder / "still", []

        def restart():
            end = time.monotonic() + 120
            while not (folder / "stands").exists() and time.monotonic() < end:
                time.sleep(0.05)
            self.broker.terminate()
            self.broker.wait()
            self.start_broker(self.address)
            with eigencast.Subscriber(f"{self.origin}/still/moves?rate=raw", cache_dir="") as subscriber:
                while not seen and time.monotonic() < end:
                    seen.extend(filter(None, [subscriber.next(timeout=0.1)]))
            (folder / "again").touch()

        other = threading.Thread(target=restart)
        other.start()
        result, _, _ = self.run_in_blender("still")
        other.join()
        self.assertEqual(len(seen), 1)
        self.assertEqual(result["taken"], 2)

    def test_in_a_window_it_plays_and_the_panel_says_so(self):
        result, sent, came = self.run_in_blender("window", ("xvfb-run", "-a", "-s", "-screen 0 800x600x24", "blender", "--window-geometry", "0", "0", "800", "600"))
        self.assert_all_came(result, sent, came)
        self.assertGreaterEqual(result["frames"], 12)
        self.assertIn("live", result["panel"][0])
        self.assertIn("poses sent", result["panel"][1])


if __name__ == "__main__":
    cases.main(argv=[sys.argv[0], *sys.argv[4:]])
