#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Programs that are killed while a memory of poses grows: sender, broker, a broker that follows another over NATS, and a broker that
records. The reference decoder and the native viewer then show what is sent: nothing stale, nothing foreign, the same bits.

    remember_test.py BROKER SENDER CLIENT [-v]

The case of two brokers is skipped without nats-server.
"""
import array
import json
import math
import pathlib
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
import unittest
import urllib.request

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/support")]
import cases
from reference_viewer import ReferenceViewer
from tubes import lines, mesh_of
from websocket_peer import free_ports, ports_of

BROKER = SENDER = CLIENT = None
PATIENCE_S = 150
RANK, RINGS, SIDES = 24, 30, 16
LOOP = 90  # Poses: a memory takes some seconds, and as many generations, to hold them.
FAR = 0.01  # Between the coefficients of a pose as it is received at two times: some times what coding may add. Neighbours are 0.03 apart,
STRANGE = 0.15  # and this is further from a pose than those are that a starved viewer may lack around it.


def tube(number):
    """It always moves, and no two poses of a turn are alike."""
    t, points = math.tau * number / LOOP, array.array("f")
    for i in range(RINGS):
        along = i / RINGS
        for j in range(SIDES):
            around = math.tau * j / SIDES
            points.extend((along + 0.3 * math.sin(t), 0.2 * math.cos(around) + 0.3 * math.cos(t) + 0.1 * math.sin(5 * along + 3 * t),
                           0.2 * math.sin(around) + 0.1 * math.sin(2 * along - 2 * t)))
    return points


def write_clip(folder):
    (folder / "tube.obj").write_text(mesh_of(tube(0), SIDES))
    head = struct.pack("<12siiffi", b"POINTCACHE2\0", 1, RINGS * SIDES, 0, 1, LOOP)
    (folder / "tube.pc2").write_bytes(head + b"".join(tube(number).tobytes() for number in range(LOOP)))


class Remembering(unittest.TestCase):
    def setUp(self):
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="eigencast-remember-"))
        self.addCleanup(shutil.rmtree, self.folder)
        write_clip(self.folder)
        self.senders = 0

    def start(self, *command):
        process = subprocess.Popen(list(map(str, command)))
        self.addCleanup(process.wait)
        self.addCleanup(process.kill)
        return process

    def start_broker(self, name="broker", port=0, *more):
        file = self.folder / f"port-{name}"
        file.unlink(missing_ok=True)
        process = self.start(BROKER, f"--listen=127.0.0.1:{port}", "--admin-listen=127.0.0.1:0", f"--port-file={file}",
                             f"--data-dir={self.folder / name}", "--log-level=error", "--recording-include-asset",
                             "--frames-ladder=false", *more)  # All bands, however busy the machine is.
        process.port, process.admin = ports_of(file)
        return process

    def start_sender(self, port):
        self.senders += 1
        return self.start(SENDER, "--no-progress", "play", self.folder / "tube.pc2", "--rest", self.folder / "tube.obj", "--to",
                          f"http://127.0.0.1:{port}/live/tube", "--cache", self.folder / "bakes", "--wait", "--rank", RANK, "--rate", "30",
                          "--memory", "on", "--record", self.folder / f"sent-{self.senders}")

    def start_viewer(self, port):
        record = self.folder / "seen"
        return record, self.start(CLIENT, f"http://127.0.0.1:{port}/live/tube", "--rate", "raw", "--headless", "--size", "16x16", "--duration", "600",
                                  "--wait", PATIENCE_S, "--record", record, "--cache", "")

    def watch(self, port, stream="live/tube"):
        viewer = ReferenceViewer(port, stream)
        self.addCleanup(viewer.end)
        return viewer

    def wait(self, what, condition):
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            self.assertLess(time.monotonic(), deadline, what)
            time.sleep(0.02)

    def wait_within_generations(self, viewer):
        """Some poses are remembered, and not all of them yet."""
        before = viewer.memories
        self.wait("nothing is remembered", lambda: viewer.memories >= before + 2)

    def kill(self, process):
        process.send_signal(signal.SIGKILL)
        process.wait()

    def wait_until_recalled(self, viewer, record=None, keys=60):
        """Of the epoch that began last."""
        before, epochs = viewer.recalled, len(viewer.epochs)
        seen = len(lines(record)) if record else 0
        self.wait("no keys are predicted from the memory", lambda: viewer.recalled >= before + keys * (1 + len(viewer.epochs) - epochs))
        if record:
            self.wait("the viewer does not go on", lambda: len(lines(record)) >= seen + keys)

    def check(self, *viewers, record=None):
        """All that was received of a pose of the clip is that pose. Returns one of each."""
        frames = {tick["capture_us"]: tick["frame"] for run in range(self.senders) for tick in lines(self.folder / f"sent-{run + 1}")}
        first, checked = {}, 0

        def check_pose(capture_us, values):
            if capture_us not in frames:  # The sender was killed before it wrote the line.
                return 0
            distance = math.dist(first.setdefault(frames[capture_us], values), values)
            self.assertLess(distance, FAR, f"frame {frames[capture_us]} is not what it was")
            return 1

        seen = {(pose["epoch"], pose["sequence"]): pose for pose in lines(record)} if record else {}
        checked += sum(check_pose(pose["capture_us"], pose["coefficients"]) for pose in seen.values())
        for viewer in viewers:
            viewer.end()
            poses = [pose for epoch in viewer.epochs for pose in epoch.poses()]
            checked += sum(check_pose(pose.capture_us, pose.values) for pose in poses)
            recalled = sum(pose.recalled for pose in poses)
            self.assertGreaterEqual(recalled, 60)
            for before, after in zip(poses, poses[1:]):
                self.assertLessEqual((before.epoch, before.sequence), (after.epoch, after.sequence))
            # Who does not hold the memory yet gets other keys of the same poses.
            alike = sum(pose.recalled and seen.get((pose.epoch, pose.sequence), {}).get("coefficients") == pose.values for pose in poses)
            if record:
                self.assertGreaterEqual(alike, 10)
        self.assertGreater(checked, 50)
        return first.values()

    def test_a_killed_sender(self):
        broker = self.start_broker()
        viewer, (record, _) = self.watch(broker.port), self.start_viewer(broker.port)
        for _ in range(2):
            sender = self.start_sender(broker.port)
            self.wait_within_generations(viewer)
            self.kill(sender)
        self.start_sender(broker.port)
        self.wait_within_generations(viewer)
        self.wait_until_recalled(viewer, record)
        self.check(viewer, record=record)

    def test_a_killed_broker(self):
        broker = self.start_broker()
        viewer, (record, _) = self.watch(broker.port), self.start_viewer(broker.port)
        self.start_sender(broker.port)
        for _ in range(2):
            self.wait_within_generations(viewer)
            self.kill(broker)
            broker = self.start_broker("broker", broker.port)
        self.wait_until_recalled(viewer, record)
        self.check(viewer, record=record)
        with urllib.request.urlopen(f"http://127.0.0.1:{broker.admin}/metrics") as answer:
            metrics = dict(line.rsplit(" ", 1) for line in answer.read().decode().splitlines() if line[0] != "#")
        of_memory, of_keys = (float(metrics[f'eigencast_broker_frame_bytes_received_total{{predicted_from="{what}"}}']) for what in ("memory", "keys"))
        self.assertGreater(of_memory, 0)
        self.assertGreater(of_keys, 0)

    def test_a_killed_follower(self):
        if not shutil.which("nats-server"):
            self.skipTest("no nats-server")
        nats, = free_ports(1)
        self.start("nats-server", "-a", "127.0.0.1", "-p", nats, "-js", "-sd", self.folder / "nats", "-l", self.folder / "nats.log")
        backbone = [f"--backbone-servers=nats://127.0.0.1:{nats}"]
        here, there = self.start_broker("here", 0, *backbone), self.start_broker("there", 0, *backbone)
        near, far, (record, _) = self.watch(here.port), self.watch(there.port), self.start_viewer(there.port)
        self.start_sender(here.port)
        self.wait_within_generations(far)
        self.kill(there)
        there = self.start_broker("there", there.port, *backbone)
        self.wait_until_recalled(far, record)
        self.kill(here)  # The one that the sender is at.
        here = self.start_broker("here", here.port, *backbone)
        self.wait_until_recalled(far, record)
        self.check(near, far, record=record)

    def test_what_a_killed_broker_recorded(self):
        broker = self.start_broker()
        viewer = self.watch(broker.port)
        self.start_sender(broker.port)
        self.wait("no stream", lambda: viewer.epochs)
        urllib.request.urlopen(f"http://127.0.0.1:{broker.admin}/api/recordings/start?stream=live/tube", data=b"").close()
        self.wait_within_generations(viewer)
        recordings = self.folder / "broker/recordings"
        size = lambda: sum(path.stat().st_size for path in recordings.iterdir())
        self.wait_until_recalled(viewer)
        before = size()
        self.wait("nothing is written", lambda: size() > before)
        self.kill(broker)
        recording, = recordings.iterdir()

        elsewhere = self.start_broker("elsewhere")
        again = self.watch(elsewhere.port, "live/again")
        self.start(SENDER, "--no-progress", "replay", recording, "--to", f"http://127.0.0.1:{elsewhere.port}/live/again", "--loop")
        self.wait("no keys are predicted from the memory", lambda: again.recalled >= 30)
        known = self.check(viewer)
        again.end()
        # On a busy machine each of the two has poses that the other lacks.
        seen = {tuple(pose.values) for epoch in viewer.epochs for pose in epoch.poses()}
        replayed = [tuple(pose.values) for epoch in again.epochs for pose in epoch.poses() if pose.recalled]
        self.assertGreaterEqual(len(replayed), 30)
        self.assertGreaterEqual(sum(values in seen for values in replayed), 10)
        for values in replayed:
            self.assertTrue(values in seen or min(math.dist(one, values) for one in known) < STRANGE)


if __name__ == "__main__":
    BROKER, SENDER, CLIENT = sys.argv[1:4]
    cases.main(argv=[sys.argv[0], *sys.argv[4:]])
