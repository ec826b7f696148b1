#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""A broker with two event loops, over TLS: one stream at the viewers of both, a reload that reaches both, a stop that tells both.

    loops_test.py BROKER [-v]
"""
import json
import os
import pathlib
import signal
import ssl
import subprocess
import sys
import tempfile
import time
import unittest
import urllib.request

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/support"), str(ROOT / "bench/broker")]
import payloads
from websocket_peer import BINARY, TEXT, Broker, Peer, frame, ports_of

BROKER = None
SUBPROTOCOL = "eigencast.v1"
VIEWERS, KEYS, ENDS = 8, 30, [4, 8]


def control(**message):
    return frame(TEXT, json.dumps(message).encode())


def next_control(peer, op):
    while True:
        opcode, payload = peer.receive()
        if opcode == TEXT and (message := json.loads(payload))["op"] == op:
            return message


def next_sequence(peer):
    while True:
        opcode, payload = peer.receive()
        if opcode == BINARY:
            return int.from_bytes(payload[11:19], "little")


class Loops(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2",
                        "-keyout", "key.pem", "-out", "cert.pem", "-subj", "/CN=localhost"], cwd=self.folder, check=True, capture_output=True)
        self.tls = ssl.create_default_context(cafile=self.folder / "cert.pem")
        self.tls.check_hostname = False
        self.configure(streams=1000)
        self.broker = Broker(BROKER, f"--config={self.folder / 'broker.toml'}", "--threads=2")
        self.addCleanup(lambda: self.broker and self.broker.__exit__())
        self.port, self.admin = ports_of(pathlib.Path(self.broker.folder) / "port")

    def configure(self, streams):
        (self.folder / "broker.toml").write_text(f'[tls]\ncertificate = "{self.folder}/cert.pem"\nkey = "{self.folder}/key.pem"\n'
                                                 f"[per_address]\nstreams = {streams}\n")

    def connect(self, path):
        return Peer(self.port, path, SUBPROTOCOL, tls=self.tls)

    def ask(self, target):
        with urllib.request.urlopen(f"http://127.0.0.1:{self.admin}{target}") as answer:
            return answer.read().decode()

    def publish(self):
        body, name = payloads.asset()
        put = urllib.request.Request(f"https://127.0.0.1:{self.port}/v1/assets/{name}", data=body, method="PUT")
        urllib.request.urlopen(put, context=self.tls).close()
        sender = self.connect("/v1/publish/a")
        sender.send(frame(TEXT, payloads.announce(name, ENDS[-1], "float32", ENDS, 100).encode()))
        next_control(sender, "announced")
        return sender

    def test_two_loops_are_one_broker(self):
        sender = self.publish()
        viewers = [self.connect("/v1/subscribe/a?rate=raw") for _ in range(VIEWERS)]
        for viewer in viewers:
            self.assertEqual(next_control(viewer, "stream")["state"], "live")
        for thread in "01":
            self.assertRegex(self.ask("/metrics"), r'thread_connections\{thread="%s"\} [45]\n' % thread)
        bands = [[0.5] * (3 * (end - begin)) for begin, end in zip([0, *ENDS], ENDS)]
        for sequence in range(KEYS):
            kind = payloads.KEY if sequence else payloads.JOIN
            sender.send(frame(BINARY, payloads.float_frame(kind, sequence, 1_000_000 + sequence * 10_000, bands)))
            for viewer in viewers:
                self.assertEqual(next_sequence(viewer), sequence)
        self.assertEqual(json.loads(self.ask("/api/broker"))["frames_sent"], KEYS * VIEWERS)

        self.configure(streams=VIEWERS)
        self.broker.process.send_signal(signal.SIGHUP)
        time.sleep(1.5)  # Who is here hears of new limits within a second.
        for viewer in viewers:
            viewer.send(control(op="subscribe", stream="b"))
            self.assertIn("per_address.streams", next_control(viewer, "error")["message"])

        os.kill(self.broker.process.pid, signal.SIGTERM)
        for peer in [sender, *viewers]:
            self.assertEqual(next_control(peer, "bye")["reason"], "the broker is stopping")
            peer.sock.close()
        self.assertEqual(self.broker.process.wait(10), 0)
        self.broker = None


if __name__ == "__main__":
    BROKER = sys.argv.pop(1)
    unittest.main(verbosity=2, warnings="ignore")
