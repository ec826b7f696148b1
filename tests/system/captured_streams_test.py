#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Streams as a broker serves them, in every mode, read by all three decoders: the reference (Python), the one for browsers (under
Node) and the viewer's own give the same poses.

    captured_streams_test.py BROKER SENDER CLIENT NODE DATA_DIR [-v]

NODE may be empty: that decoder is then left out, with words. DATA_DIR holds the real clips; without them a built-in one is sent.
"""
import json
import pathlib
import subprocess
import sys
import tempfile
import time
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/support"), str(ROOT / "tools")]
import reference_decoder
from websocket_peer import BINARY, TEXT, Broker, Peer, frame

BROKER = SENDER = CLIENT = NODE = DATA = None
SECONDS = 2.5
LEAST_POSES = 40
RANK = 80
# Stream, query, what the poses between keys are made by.
MODES = {
    "raw": ("clip", "rate=raw", "linear"),
    "full": ("clip", "rate=interpolated&k=3", "linear"),
    "compact": ("clip", "rate=interpolated&k=3&form=compact", "linear"),
    "catmull-rom": ("clip", "rate=interpolated&k=3&scheme=catmull-rom", "linear"),
    "estimated": ("clip", "rate=estimated&k=3", "damped"),
    "estimated-compact": ("clip", "rate=estimated&k=2&form=compact&scheme=linear", "linear"),
    "two-bands": ("clip", "rate=raw&bands=2", "linear"),
    "hermite": ("moving", "rate=interpolated&k=3&scheme=hermite", "hermite"),
    "hermite-compact": ("moving", "rate=interpolated&k=4&scheme=hermite&form=compact", "hermite"),
}
WATCHED = ("compact", "hermite-compact")  # By a real viewer as well: keys, joins, and poses that it makes itself.


def clip():
    real = pathlib.Path(DATA) / "animations/horse-gallop/vertices.npy"
    if real.exists():
        return real
    print(f"no {real}: a built-in clip instead", file=sys.stderr)
    return "bar:twist"


class Capture:
    """What one viewer is sent: the format, and the frames from its first join on."""

    def __init__(self, port, stream, query):
        self.peer = Peer(port, f"/v1/subscribe/{stream}?{query}", "eigencast.v1")
        self.stream, self.format, self.frames = stream, None, []

    def until_s(self):
        return int.from_bytes(self.frames[-1][19:27], "little") * 1e-6 if self.frames else 0

    def read(self, seconds):
        """On until poses are so much younger; 0: to the first."""
        begin_s = self.until_s()
        while not self.frames or self.until_s() < begin_s + seconds:
            opcode, payload = self.peer.receive()
            if opcode == BINARY:
                self.frames.append(payload)
            elif opcode == TEXT and (message := json.loads(payload)).get("state") == "live":
                self.format = message["format"]

    def ask(self, **profile):
        self.peer.send(frame(TEXT, json.dumps({"op": "subscribe", "stream": self.stream, "profile": profile}).encode()))

    def write(self, path, scheme):
        text = "format " + json.dumps({**self.format, "scheme": scheme}) + "\n"
        path.write_text(text + "".join(bytes.hex(f) + "\n" for f in self.frames))


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
            senders = [subprocess.Popen([SENDER, "--no-progress", "play", *what, "--to", url + stream, *common], stderr=subprocess.DEVNULL)
                       for stream, what in (("clip", [clip()]), ("moving", ["heart", "--velocities"]))]
            try:
                captures = {name: Capture(broker.port, stream, query) for name, (stream, query, _) in MODES.items()}
                for capture in captures.values():
                    capture.peer.sock.settimeout(120)  # The bakes of both come first.
                    capture.read(0)
                viewers = [cls.watch(url, name) for name in WATCHED]
                for capture in captures.values():
                    capture.read(SECONDS)
                changing = captures["raw"]
                for profile in ({"rate": "raw", "bands": 1}, {"rate": "interpolated", "k": 3, "form": "full", "bands": 2}, {"rate": "raw"}):
                    changing.ask(**profile)
                    changing.read(0.5)
                for viewer in viewers:
                    if viewer.wait(120) != 0:
                        raise RuntimeError(f"{viewer.args[0]} ended with {viewer.returncode}")
                for capture in captures.values():
                    capture.peer.sock.close()
            finally:
                for sender in senders:
                    sender.terminate()
                    sender.wait(20)
        cls.decoded = {}
        for name, capture in captures.items():
            path = cls.folder / f"{name}.frames"
            capture.write(path, MODES[name][2])
            lines = reference_decoder.decoded_lines(path)  # Raises on what breaks the protocol.
            path.with_suffix(".jsonl").write_text("\n".join(lines) + "\n")
            cls.decoded[name] = [json.loads(line) for line in lines]

    @classmethod
    def tearDownClass(cls):
        cls.temporary.cleanup()

    @classmethod
    def watch(cls, url, name):
        stream, query, _ = MODES[name]
        return subprocess.Popen([CLIENT, f"{url}{stream}?{query}", "--headless", "--size", "16x16", "--lod", "0.02", "--wait", "120",
                                 "--duration", "3", "--record", cls.folder / f"{name}.record"], stderr=subprocess.DEVNULL)

    def test_no_frame_has_to_wait_for_a_join(self):
        for name, poses in self.decoded.items():
            with self.subTest(name):
                self.assertGreaterEqual(len(poses), LEAST_POSES)
                self.assertEqual(poses[0]["kind"], "join")
                self.assertNotIn(None, poses)

    def test_each_mode_brings_what_it_is_for(self):
        kinds = {name: {pose["kind"] for pose in poses} for name, poses in self.decoded.items()}
        for name, kind in (("full", "synthetic"), ("compact", "step"), ("catmull-rom", "synthetic"), ("estimated", "estimate"),
                           ("estimated-compact", "estimate"), ("hermite", "synthetic"), ("hermite-compact", "step")):
            self.assertIn(kind, kinds[name], name)
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
                for pose in self.decoded[name]:
                    key = pose.get("pose") or pose["newer"]
                    expected[pose["capture_us"]] = [value * step_size(key["step"]) for value in key["values"]]
                seen = {}
                for line in (self.folder / f"{name}.record").read_text().splitlines():
                    pose = json.loads(line)
                    seen[pose["capture_us"]] = pose["coefficients"]
                both = expected.keys() & seen.keys()
                self.assertGreater(len(both), LEAST_POSES)
                for capture_us in both:
                    self.assertEqual(expected[capture_us], seen[capture_us])


if __name__ == "__main__":
    BROKER, SENDER, CLIENT, NODE, DATA = sys.argv[1:6]
    unittest.main(argv=[sys.argv[0], *sys.argv[6:]])
