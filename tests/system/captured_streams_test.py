#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Streams as a broker serves them, in every mode, read by all three decoders: the reference (Python), the one for browsers (under
Node) and the viewer's own give the same poses.

    captured_streams_test.py BROKER SENDER CLIENT NODE MADE_DATA [-v]

NODE may be empty: that decoder is then left out, and the test is a skip. MADE_DATA: what tests/support/make_data.py made.
"""
import json
import os
import pathlib
import socket
import subprocess
import sys
import tempfile
import threading
import time
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/support"), str(ROOT / "tools"), str(ROOT / "bench/broker")]
import cases
import payloads
import reference_decoder
from websocket_peer import BINARY, TEXT, Broker, Peer, frame

BROKER = SENDER = CLIENT = NODE = MADE_DATA = None
PATIENCE_S = 120
MIN_POSES = 40
RANK = 80
# Stream, query, what the poses between keys are made by.
MODES = {
    "raw": ("clip", "rate=raw", "linear"),
    "linear": ("clip", "rate=interpolated&k=3", "linear"),
    "catmull-rom": ("clip", "rate=interpolated&k=3&scheme=catmull-rom", "linear"),
    "estimated": ("clip", "rate=estimated&k=3", "damped"),
    "estimated-linear": ("clip", "rate=estimated&k=2&scheme=linear", "linear"),
    "two-bands": ("clip", "rate=raw&bands=2", "linear"),
    "hermite": ("moving", "rate=interpolated&k=4&scheme=hermite", "hermite"),
}
WATCHED = ("linear", "catmull-rom", "hermite")  # By a real viewer as well: keys, joins, and poses that it makes itself.


def clip():
    """A gait: a real one, or what stands in."""
    folder = pathlib.Path(os.environ.get("EIGENCAST_DATA_DIR") or MADE_DATA) / "animations"
    real = folder / "horse-gallop"
    return real if real.exists() else folder / "animal-walk"


def wait_until(what, condition):
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError(f"{what}: not within {PATIENCE_S} s")
        time.sleep(0.05)


class Capture:
    """What one viewer is sent, from its first join on; a thread reads until close()."""

    def __init__(self, port, stream, query):
        self.peer = Peer(port, f"/v1/subscribe/{stream}?{query}", "eigencast.v2")
        self.peer.sock.settimeout(PATIENCE_S)
        self.stream, self.format, self.frames, self.heads, self.closing = stream, None, [], [], False
        self.chain = payloads.Chain()
        self.thread = threading.Thread(target=self.read)
        self.thread.start()

    def read(self):
        try:
            while True:
                opcode, payload = self.peer.receive()
                if opcode == BINARY:
                    self.frames.append(payload)
                    self.heads.append(self.chain.read(payload))
                elif opcode == TEXT and (message := json.loads(payload)).get("state") == "live":
                    self.format = message["format"]
        except (OSError, EOFError):
            if not self.closing:
                raise

    def close(self):
        self.closing = True
        self.peer.sock.shutdown(socket.SHUT_RDWR)
        self.thread.join()
        self.peer.sock.close()

    def capture_times(self):
        return {head.shown_us for head in self.heads}

    def ask(self, mask, **profile):
        """Returns when a frame with just these bands came."""
        begin = len(self.heads)
        self.peer.send(frame(TEXT, json.dumps({"op": "subscribe", "stream": self.stream, "profile": profile}).encode()))
        wait_until(f"bands {mask}", lambda: any(head.bands == mask for head in self.heads[begin:]))

    def write(self, path, scheme):
        text = "format " + json.dumps({**self.format, "scheme": scheme}) + "\n"
        path.write_text(text + "".join(bytes.hex(f) + "\n" for f in self.frames))


class Viewer:
    """A real viewer without a window that records what it receives."""

    def __init__(self, url, record):
        self.record = record
        self.process = subprocess.Popen([CLIENT, url, "--headless", "--size", "16x16", "--lod", "0.02", "--wait", str(PATIENCE_S),
                                         "--duration", "600", "--record", record], stderr=subprocess.DEVNULL)

    def poses(self):
        """By capture time. The last line may still be half written."""
        lines = self.record.read_text().split("\n")[:-1] if self.record.exists() else []
        return {pose["capture_us"]: pose["coefficients"] for pose in map(json.loads, lines)}

    def end(self):
        self.process.terminate()
        if (code := self.process.wait(PATIENCE_S)) != 0:
            raise RuntimeError(f"{self.process.args[0]} ended with {code}")


def step_size(index):
    return 2 ** (index % 4 / 4) * 2.0 ** (index // 4 - 40)


class CapturedStreams(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.temporary = tempfile.TemporaryDirectory()
        cls.folder = pathlib.Path(cls.temporary.name)
        with Broker(BROKER) as broker:
            url = f"ws://127.0.0.1:{broker.port}/"
            common = ["--rank", str(RANK), "--rate", "30"]
            senders = [subprocess.Popen([SENDER, "--no-progress", "play", "--wait", "--memory", "off", *what, "--to", url + stream, *common], stderr=subprocess.DEVNULL)
                       for stream, what in (("clip", [clip()]), ("moving", ["heart", "--velocities"]))]
            captures, viewers = {}, {}
            try:
                captures = {name: Capture(broker.port, stream, query) for name, (stream, query, _) in MODES.items()}
                for name, capture in captures.items():  # The bakes of both clips come first.
                    wait_until(f"{name}: frames", lambda: capture.frames)
                viewers = {name: Viewer(f"{url}{MODES[name][0]}?{MODES[name][1]}", cls.folder / f"{name}.record") for name in WATCHED}
                for name, capture in captures.items():
                    wait_until(f"{name}: poses", lambda: len(capture.frames) >= MIN_POSES)
                raw = captures["raw"]
                raw.ask(1, rate="raw", bands=1)
                raw.ask(3, rate="interpolated", k=3, bands=2)
                raw.ask(7, rate="raw")
                # A viewer joins when its geometry is ready: the captures go on until both have enough of the same poses.
                for name, viewer in viewers.items():
                    wait_until(f"{name}: common poses",
                               lambda: len(captures[name].capture_times() & viewer.poses().keys()) > MIN_POSES)
                for viewer in viewers.values():
                    viewer.end()
            finally:
                for viewer in viewers.values():
                    viewer.process.kill()
                    viewer.process.wait()
                for capture in captures.values():
                    capture.close()
                for sender in senders:
                    sender.terminate()
                    sender.wait(20)
        cls.viewed = {name: viewer.poses() for name, viewer in viewers.items()}
        cls.decoded, cls.heads = {}, {name: capture.heads for name, capture in captures.items()}
        for name, capture in captures.items():
            path = cls.folder / f"{name}.frames"
            capture.write(path, MODES[name][2])
            lines = reference_decoder.decoded_lines(path)  # Raises on what breaks the protocol.
            path.with_suffix(".jsonl").write_text("\n".join(lines) + "\n")
            cls.decoded[name] = [json.loads(line) for line in lines]

    @classmethod
    def tearDownClass(cls):
        cls.temporary.cleanup()

    def test_no_frame_has_to_wait_for_a_join(self):
        for name, poses in self.decoded.items():
            with self.subTest(name):
                self.assertGreaterEqual(len(poses), MIN_POSES)
                self.assertEqual(poses[0]["kind"], "join")
                self.assertNotIn(None, poses)

    def test_each_mode_brings_what_it_is_for(self):
        kinds = {name: {pose["kind"] for pose in poses} for name, poses in self.decoded.items()}
        for name, kind in (("linear", "step"), ("catmull-rom", "step"), ("estimated", "estimate"), ("estimated-linear", "estimate"),
                           ("hermite", "step")):
            self.assertIn(kind, kinds[name], name)
        for name in self.decoded:
            residuals = any(pose["kind"] == "step" and pose["bands"] for pose in self.decoded[name])
            self.assertEqual(residuals, name == "catmull-rom", name)
        for name in ("linear", "hermite"):
            self.assertTrue(any(pose["kind"] == "key" and "shown" in pose for pose in self.decoded[name]), name)
        self.assertEqual({pose["bands"] for pose in self.decoded["two-bands"]}, {3})
        self.assertGreaterEqual({pose["bands"] for pose in self.decoded["raw"] if pose["bands"]}, {1, 3, 7}, "bands go and come back")

    def test_the_decoder_for_browsers_reads_the_same(self):
        if not NODE:
            self.skipTest("no node (Debian: nodejs)")
        done = subprocess.run([NODE, ROOT / "sdk/js/check_golden.mjs", self.folder, "--undamaged"], capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        self.assertEqual(done.stdout.count("as expected"), len(MODES), done.stdout)

    def test_a_real_viewer_reads_the_same(self):
        for name in WATCHED:
            with self.subTest(name):
                expected = {}
                for pose, head in zip(self.decoded[name], self.heads[name]):
                    if head.ahead and not head.at:
                        continue
                    key = pose.get("shown") or pose.get("pose") or pose["newer"]
                    expected[head.shown_us] = [value * step_size(key["step"]) for value in key["values"]]
                seen = self.viewed[name]
                both = expected.keys() & seen.keys()
                self.assertGreater(len(both), MIN_POSES)
                for capture_us in both:
                    self.assertEqual(expected[capture_us], seen[capture_us])


if __name__ == "__main__":
    BROKER, SENDER, CLIENT, NODE, MADE_DATA = sys.argv[1:6]
    cases.main(argv=[sys.argv[0], *sys.argv[6:]])
