#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""A stream that learns columns: viewers see one continuous stream of less error and fetch the columns alone, and programs that are
killed while the stream changes over come back to what is sent.

    learn_test.py BROKER SENDER CLIENT NODE [-v]

NODE may be empty: the decoder for browsers is then left out, and the test is a skip.
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
import urllib.request

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/support"), str(ROOT / "tools")]
import cases
import reference_asset_reader
import reference_decoder
from reference_viewer import ReferenceViewer
from tubes import lines, mesh_of
from websocket_peer import TEXT, Peer, ports_of

BROKER = SENDER = CLIENT = NODE = None
PATIENCE_S = 240
RANK, RINGS, SIDES = 40, 60, 24


def point(number, vertex):
    """Of a tube, which sways, as its basis can, and folds, as a few columns can."""
    t, along, around = 0.2 * number, vertex // SIDES / RINGS, math.tau * (vertex % SIDES) / SIDES
    radius = 0.2 + 0.02 * (math.sin(t) * math.cos(150 * along) + math.cos(1.7 * t) * math.sin(120 * along))
    return along + 0.1 * math.sin(0.7 * t), radius * math.cos(around) + 0.2 * math.sin(3 * along + t), radius * math.sin(around)


def pose(number):
    return array.array("f", (value for vertex in range(RINGS * SIDES) for value in point(number, vertex))).tobytes()


class Scene:
    """A broker that keeps folder and port, a sender that learns, and viewers that record what they receive."""

    def __init__(self):
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="eigencast-learn-"))
        (self.folder / "tube.obj").write_text(mesh_of(pose(0), SIDES))
        self.viewers, self.feeders = 0, []
        self.start_broker("127.0.0.1:0")

    def start_broker(self, listen):
        (self.folder / "port").unlink(missing_ok=True)
        self.broker = subprocess.Popen([BROKER, f"--listen={listen}", "--admin-listen=127.0.0.1:0", f"--port-file={self.folder / 'port'}",
                                        f"--data-dir={self.folder / 'broker'}", "--log-level=error",
                                        "--frames-ladder=false"])  # All bands, however busy the machine is.
        self.port = ports_of(self.folder / "port")[0]
        self.url = f"http://127.0.0.1:{self.port}/live/tube"

    def start_sender(self, *more):
        self.sender = subprocess.Popen([SENDER, "pipe", "--mesh", self.folder / "tube.obj", "--to", self.url, "--cache", self.folder / "bakes", "--wait",
                                        "--rank", str(RANK), "--rate", "30", "--learn", "on", "--json", self.folder / "report", *more], stdin=subprocess.PIPE)
        feeder = threading.Thread(target=self.feed, args=(self.sender,))
        feeder.start()
        self.feeders.append(feeder)

    def feed(self, sender):
        number = 0
        try:
            while True:
                sender.stdin.write(pose(number))
                number += 1
        except (BrokenPipeError, ValueError):
            pass

    def start_viewer(self, *more):
        self.viewers += 1
        record = self.folder / f"poses-{self.viewers}"
        return record, subprocess.Popen([CLIENT, self.url, "--headless", "--size", "16x16", "--duration", "600", "--wait", str(PATIENCE_S), "--record", record,
                                         "--cache", "", *more])

    def end(self, *viewers):
        for process in (*(viewer for _, viewer in viewers), self.sender, self.broker):
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
            process.wait(60)
        for feeder in self.feeders:
            feeder.join()


def ranks(poses):
    return [len(p["coefficients"]) // 3 for p in poses]


class Learning(unittest.TestCase):
    def wait(self, what, condition):
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            self.assertLess(time.monotonic(), deadline, what)
            time.sleep(0.05)

    def learnt(self, record, poses=30):
        return sum(rank > RANK for rank in ranks(lines(record))) >= poses

    def check_orders(self, poses):
        """Nothing stale, nothing foreign."""
        for before, after in zip(poses, poses[1:]):
            if before["epoch"] == after["epoch"]:
                self.assertGreaterEqual(after["sequence"], before["sequence"])
                self.assertEqual(len(before["coefficients"]), len(after["coefficients"]))
            else:
                self.assertGreater(after["epoch"], before["epoch"])

    def test_viewers_see_one_stream(self):
        scene = Scene()
        scene.start_sender()
        viewer = scene.start_viewer()
        self.wait("the stream does not change over", lambda: self.learnt(viewer[0], 60))
        later = scene.start_viewer()
        self.wait("who comes later sees nothing", lambda: self.learnt(later[0], 10))
        scene.end(viewer, later)
        report, poses = json.loads((scene.folder / "report").read_text()), lines(viewer[0])
        self.assertEqual([report["reconnects"], report["changes"]], [0, 1])
        self.check_orders(poses)
        all_ranks = ranks(poses)
        change = all_ranks.index(RANK + report["learnt_columns"])
        self.assertEqual([set(all_ranks[:change]), set(all_ranks[change:])], [{RANK}, {RANK + report["learnt_columns"]}])
        speeds = []  # Of the coefficients that both bases have.
        for before, after in zip(poses, poses[1:]):
            elapsed = (after["capture_us"] - before["capture_us"]) / 1e6
            moved = max(abs(a - b) for a, b in zip(before["coefficients"][:3 * RANK], after["coefficients"][:3 * RANK]))
            speeds.append(moved / elapsed if elapsed > 0 else 0)
        around = slice(change - 1, change + 8)
        self.assertLessEqual(max(speeds[around]), 1.5 * max(speeds[:around.start] + speeds[around.stop:]), "it jumps")
        self.assertEqual(set(ranks(lines(later[0]))), {RANK + report["learnt_columns"]})

    def test_all_readers_read_it_alike(self):
        scene = Scene()
        reference = ReferenceViewer(scene.port, "live/tube")
        scene.start_sender("--memory", "off")  # Else keys would depend on who holds what already.
        viewer = scene.start_viewer("--rate", "raw")
        self.wait("the stream does not change over", lambda: self.learnt(viewer[0], 60) and len(reference.epochs) == 2 and
                  len(reference.epochs[1].frames()) >= 60)
        learnt = self.asset_of(scene, reference.epochs[1].stream["asset"])
        reference.end()
        scene.end(viewer)

        seen = {(p["epoch"], p["sequence"]): p["coefficients"] for p in lines(viewer[0])}
        for epoch in reference.epochs:
            poses = [pose for pose in epoch.poses() if (pose.epoch, pose.sequence) in seen]
            for one in poses:
                self.assertEqual(one.values, seen[one.epoch, one.sequence])
        self.assertGreater(len(poses), 20)
        folded = max(reference.epochs[1].poses(), key=lambda one: max(map(abs, one.values[3 * RANK:])))
        self.check_errors(learnt, folded.values)

        if not NODE:
            self.skipTest("no node (Debian: nodejs)")
        frames = scene.folder / "frames"
        frames.mkdir()
        for number, epoch in enumerate(reference.epochs):
            path = frames / f"{number}.frames"
            path.write_text(f"format {json.dumps(epoch.stream['format'])}\n" + "".join(bytes.hex(f) + "\n" for f in epoch.frames()))
            path.with_suffix(".jsonl").write_text("\n".join(reference_decoder.decoded_lines(path)) + "\n")
        done = subprocess.run([NODE, ROOT / "sdk/js/check_golden.mjs", frames, "--undamaged"], capture_output=True, text=True)
        self.assertEqual([done.returncode, done.stdout.count("as expected")], [0, 2], done.stdout + done.stderr)

    def asset_of(self, scene, name):
        def fetched(id):
            with urllib.request.urlopen(f"http://127.0.0.1:{scene.port}/v1/assets/{id}", timeout=60) as answer:
                return answer.read()
        manifest = fetched(name)
        facts = reference_asset_reader.read_manifest(manifest)
        return reference_asset_reader.read_asset(manifest, [fetched(chunk["id"].hex()) for chunk in facts["chunks"]], fetched(facts["columns"][1].hex()))

    def check_errors(self, asset, C):
        """Of a pose that was sent: columns take most of what the basis misses."""
        def errors(rank):
            for row, source in zip(asset["basis"], asset["source_vertex"]):
                rebuilt = [asset["origin"][d] + sum(row[k] * C[3 * k + d] for k in range(rank)) for d in range(3)]
                yield source, rebuilt
        shown = dict(errors(asset["r"]))
        distance = lambda number, rebuilt, vertices: sum(math.dist(point(number, v), rebuilt[v]) ** 2 for v in vertices)
        number = min(range(6000), key=lambda n: distance(n, shown, range(0, RINGS * SIDES, 97)))
        with_columns, without = (distance(number, dict(errors(rank)), range(RINGS * SIDES)) for rank in (asset["r"], RANK))
        self.assertLess(4 * with_columns, without)

    def in_the_middle(self):
        """A scene whose stream changes over, but for a viewer that never has what is next: half a minute is left."""
        scene = Scene()
        mute = Peer(scene.port, "/v1/subscribe/live/tube?rate=raw", "eigencast.v2")
        told = threading.Event()
        threading.Thread(target=self.read, args=(mute, told), daemon=True).start()
        scene.start_sender()
        viewer = scene.start_viewer()
        self.assertTrue(told.wait(PATIENCE_S), "nothing is prepared")
        self.wait("no poses", lambda: lines(viewer[0]))
        return scene, viewer

    def read(self, peer, told):
        """To the end: else its link would be a slow one."""
        peer.sock.settimeout(PATIENCE_S)
        try:
            while True:
                opcode, payload = peer.receive()
                if opcode == TEXT and (json.loads(payload).get("next") or {}).get("asset"):
                    told.set()
        except (OSError, EOFError):
            pass

    def test_a_killed_sender(self):
        scene, viewer = self.in_the_middle()
        scene.sender.kill()
        scene.sender.wait()
        scene.start_sender()
        self.wait("it does not learn again", lambda: self.learnt(viewer[0]))
        scene.end(viewer)
        self.check_orders(lines(viewer[0]))

    def test_a_killed_broker(self):
        scene, viewer = self.in_the_middle()
        scene.broker.kill()
        scene.broker.wait()
        scene.start_broker(f"127.0.0.1:{scene.port}")
        self.wait("it does not go on with what it learnt", lambda: self.learnt(viewer[0]))
        scene.end(viewer)
        self.check_orders(lines(viewer[0]))

    def test_a_killed_viewer(self):
        scene, viewer = self.in_the_middle()
        viewer[1].kill()
        viewer[1].wait()
        again = scene.start_viewer()
        self.wait("it does not see what was learnt", lambda: self.learnt(again[0]))
        scene.end(again)
        self.check_orders(lines(again[0]))


if __name__ == "__main__":
    BROKER, SENDER, CLIENT, NODE = sys.argv[1:5]
    cases.main(argv=[sys.argv[0], *sys.argv[5:]])
