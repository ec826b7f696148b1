#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""A living sender, and viewers, that know three brokers over one NATS server: brokers are killed one after the other.

    resume_test.py FOLDER-OF-PROGRAMS [-v]

Skipped without nats-server.
"""
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time
import unittest
import urllib.request

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/support"), str(ROOT / "bench/broker"), str(pathlib.Path(__file__).parent)]
import cases
import payloads
from viewer import Viewer
from websocket_peer import TEXT, Peer, frame, free_ports

PROGRAMS = None


class Resume(unittest.TestCase):
    def setUp(self):
        if not shutil.which("nats-server"):
            self.skipTest("no nats-server")
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="eigencast-resume-"))
        self.addCleanup(shutil.rmtree, self.folder, ignore_errors=True)
        self.nats, *rest = free_ports(7)
        self.data, self.admin = rest[:3], rest[3:]
        self.brokers = {}
        self.run_until_end("nats-server", "-a", "127.0.0.1", "-p", self.nats, "-js", "-sd", self.folder / "jetstream")
        for number in range(3):
            self.start(number)
        for number in range(3):
            self.wait_for(lambda: "3 brokers" in self.ask(number, "/api/broker"), "they do not meet")

    def run_until_end(self, *command, **options):
        with open(self.folder / "log", "a") as log:
            process = subprocess.Popen([str(word) for word in command], stdout=log, stderr=log, **options)
        self.addCleanup(process.wait)
        self.addCleanup(process.kill)
        return process

    def start(self, number):
        self.brokers[number] = self.run_until_end(
            PROGRAMS / "eigencast-broker", f"--listen=127.0.0.1:{self.data[number]}", f"--admin-listen=127.0.0.1:{self.admin[number]}",
            f"--data-dir={self.folder}/data-{number}", f"--backbone-servers=nats://127.0.0.1:{self.nats}")

    def kill(self, number):
        self.brokers[number].kill()
        self.brokers[number].wait()

    def ask(self, number, path):
        try:
            return urllib.request.urlopen(f"http://127.0.0.1:{self.admin[number]}{path}", timeout=20).read().decode()
        except OSError:
            return ""

    def wait_for(self, condition, what):
        for _ in range(3000):
            if condition():
                return
            time.sleep(0.02)
        self.fail(f"{what}\n{(self.folder / 'log').read_text()[-6000:]}")

    def viewer(self, ports):
        viewer = Viewer(ports)
        self.addCleanup(setattr, viewer, "over", True)
        return viewer

    def sender_is_at(self, number):
        return '"sender"' in self.ask(number, "/api/clients")

    def test_a_living_sender_goes_on_at_another_broker(self):
        several = lambda first: ",".join(f"127.0.0.1:{self.data[(first + i) % 3]}" for i in range(3))
        self.run_until_end(PROGRAMS / "eigencast-sender", "--no-progress", "play", "--wait", "torus", "--rate", "30", "--to", f"ws://{several(0)}/s",
                           env={**os.environ, "XDG_CACHE_HOME": str(self.folder)})
        fixed = [self.viewer([port]) for port in self.data]
        moving = [self.viewer([self.data[(first + i) % 3] for i in range(3)]) for first in range(3)]
        self.wait_for(lambda: all(viewer.frames for viewer in fixed + moving), "they do not move")
        for victim in (0, 1, 2, 0):
            self.wait_for(lambda: self.sender_is_at(victim), f"the sender does not come to {victim}")
            epoch = max(viewer.epoch for viewer in fixed + moving)
            others = [fixed[number] for number in range(3) if number != victim] + moving
            self.kill(victim)
            died_us = time.monotonic_ns() // 1000
            self.wait_for(lambda: all(viewer.epoch > epoch for viewer in others), f"they do not move after {victim} died")
            print(f"  broker {victim} killed: poses of the next epoch at all after {(time.monotonic_ns() // 1000 - died_us) / 1e6:.2f} s")
            metrics = self.ask((victim + 1) % 3, "/metrics").splitlines()
            self.assertIn("eigencast_broker_backbone_claims_refused_total 0", [line for line in metrics if "claims_refused_total" in line],
                          "it did not have to wait for the lease")
            self.start(victim)
            self.wait_for(lambda: fixed[victim].epoch > epoch, "its viewers do not move")
        for viewer in fixed + moving:
            self.assertEqual(viewer.faults, [])

    def announce(self, number, resume=None):
        """What the broker answers, with the connection."""
        body, asset = payloads.asset()
        urllib.request.urlopen(urllib.request.Request(f"http://127.0.0.1:{self.data[number]}/v1/assets/{asset}", data=body, method="PUT")).close()
        _, rows = payloads.float_join(600)
        message = json.loads(payloads.announce(asset, rows, "float32"))
        if resume:
            message["resume"] = resume
        peer = Peer(self.data[number], "/v1/publish/s", "eigencast.v2")
        peer.send(frame(TEXT, json.dumps(message).encode()))
        while True:
            answer = json.loads(peer.receive()[1])
            if answer["op"] in ("announced", "error"):
                return answer, peer

    def test_only_the_secret_of_the_last_epoch_replaces_the_wait(self):
        first, _one = self.announce(0)
        second, _two = self.announce(1, first["resume"])
        self.assertEqual(second["op"], "announced", second)
        self.assertGreater(second["epoch"], first["epoch"])
        for wrong in (None, first["resume"], "0" * 64):
            answer, _ = self.announce(2, wrong)
            self.assertEqual((answer["op"], answer.get("code")), ("error", "refused"))
        self.kill(1)
        third, _three = self.announce(2, second["resume"])
        self.assertEqual(third["op"], "announced", third)
        self.assertGreater(third["epoch"], second["epoch"])
        # The row that the brokers share shows no secret.
        stored = b"".join(path.read_bytes() for path in (self.folder / "jetstream").rglob("*") if path.is_file())
        self.assertIn(b'"resume"', stored)
        for answer in (first, second, third):
            self.assertNotIn(answer["resume"].encode(), stored)


if __name__ == "__main__":
    PROGRAMS = pathlib.Path(sys.argv.pop(1)).resolve()
    cases.main()
