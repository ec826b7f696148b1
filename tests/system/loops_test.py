#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""A broker with two event loops, over TLS: one stream at the viewers of both, a reload and new certificates that reach both, assets
beside them, orders that find their clients in either, a stop that reaches both.

    loops_test.py BROKER [-v]
"""
import collections
import hashlib
import http.client
import itertools
import json
import pathlib
import random
import signal
import ssl
import subprocess
import sys
import tempfile
import threading
import time
import unittest
import urllib.request

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/support"), str(ROOT / "bench/broker")]
import cases
import payloads
from websocket_peer import BINARY, Broker, CLOSE, Peer, TEXT, control, frame, next_control, ports_of

BROKER = None
SUBPROTOCOL = "eigencast.v2"
VIEWERS, KEYS, ENDS = 8, 30, [4, 8]


chains = collections.defaultdict(payloads.Chain)  # Of senders and viewers, by peer.


def next_sequence(peer):
    while True:
        opcode, payload = peer.receive()
        if opcode == BINARY:
            return chains[peer].read(payload).sequence


def closed_with(peer):
    while True:
        opcode, payload = peer.receive()
        if opcode == CLOSE:
            peer.sock.close()
            return int.from_bytes(payload[:2], "big")


class Loops(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        self.make_certificate()
        self.configure(streams=1000)
        self.broker = Broker(BROKER, f"--config={self.folder / 'broker.toml'}", "--threads=2")
        self.addCleanup(lambda: self.broker and self.broker.__exit__())
        self.sequences = itertools.count()
        self.port, self.admin = ports_of(pathlib.Path(self.broker.folder) / "port")

    def make_certificate(self):
        """Replaces the one before; connect() trusts the new one only."""
        subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2",
                        "-keyout", "key.pem", "-out", "cert.pem", "-subj", "/CN=localhost"], cwd=self.folder, check=True, capture_output=True)
        self.tls = ssl.create_default_context(cafile=self.folder / "cert.pem")
        self.tls.check_hostname = False

    def wait_for_certificate(self):
        for _ in range(1200):
            try:
                return self.connect("/v1/subscribe").sock.close()
            except ssl.SSLCertVerificationError:  # It is still the old one.
                time.sleep(0.05)
        self.fail("the old certificate is shown to who comes now")

    def configure(self, streams):
        (self.folder / "broker.toml").write_text(f'[tls]\ncertificate = "{self.folder}/cert.pem"\nkey = "{self.folder}/key.pem"\n'
                                                 f"[per_address]\nstreams = {streams}\n")

    def connect(self, path):
        return Peer(self.port, path, SUBPROTOCOL, tls=self.tls)

    def ask(self, target, order=False):
        with urllib.request.urlopen(f"http://127.0.0.1:{self.admin}{target}", data=b"" if order else None) as answer:
            return answer.read().decode()

    def request(self, method, path, body=None, **headers):
        """Status, headers and body of the answer."""
        link = http.client.HTTPSConnection("127.0.0.1", self.port, context=self.tls, timeout=60)
        link.request(method, path, body, {name.replace("_", "-"): value for name, value in headers.items()})
        answer = link.getresponse()
        got = answer.status, answer.headers, answer.read()
        link.close()
        return got

    def watch(self, count):
        viewers = [self.connect("/v1/subscribe/a?rate=raw") for _ in range(count)]
        for viewer in viewers:
            self.assertEqual(next_control(viewer, "stream")["state"], "live")
        for thread in "01":
            self.assertRegex(self.ask("/metrics"), r'loop_connections\{loop="%s"\} [1-9]' % thread)
        return viewers

    def show(self, sender, viewers, keys=5):
        """Each of them gets so many keys more."""
        bands = [[0.5] * (3 * (end - begin)) for begin, end in zip([0, *ENDS], ENDS)]
        for sequence in itertools.islice(self.sequences, keys):
            kind = payloads.KEY if sequence else payloads.JOIN
            sender.send(frame(BINARY, payloads.float_frame(chains[sender], kind, sequence, 1_000_000 + sequence * 10_000, bands)))
            for viewer in viewers:
                while (got := next_sequence(viewer)) < sequence:  # A late viewer gets the present pose first.
                    pass
                self.assertEqual(got, sequence)

    def stop(self, peers, by_order=False):
        """All of them get a notice, and the broker ends."""
        if by_order:
            self.ask("/api/drain", order=True)
        else:
            self.broker.process.send_signal(signal.SIGTERM)
        for peer in peers:
            self.assertEqual(next_control(peer, "bye")["reason"], "the broker is stopping")
            peer.sock.close()
        self.assertEqual(self.broker.process.wait(60), 0)
        self.broker = None

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
        viewers = self.watch(VIEWERS)
        for thread in "01":
            self.assertRegex(self.ask("/metrics"), r'loop_connections\{loop="%s"\} [45]\n' % thread)
        self.show(sender, viewers, KEYS)
        self.assertEqual(json.loads(self.ask("/api/broker"))["frames_sent"], KEYS * VIEWERS)

        self.configure(streams=VIEWERS)
        self.broker.process.send_signal(signal.SIGHUP)
        for viewer in viewers:  # Present viewers learn new limits within a second or so.
            viewer.send(control(op="subscribe", stream="b"))
            while (answer := next_control(viewer, "stream", "error"))["op"] == "stream":
                viewer.send(control(op="unsubscribe", stream="b"))
                time.sleep(0.1)
                viewer.send(control(op="subscribe", stream="b"))
            self.assertIn("per_address.streams", answer["message"])

        self.stop([sender, *viewers])

    def test_new_certificates_are_for_those_who_come(self):
        sender = self.publish()
        early = self.watch(4)
        first = early[0].sock.getpeercert(binary_form=True)
        self.make_certificate()
        self.broker.process.send_signal(signal.SIGHUP)
        self.wait_for_certificate()
        late = self.watch(4)
        for viewer in late:
            self.assertNotEqual(viewer.sock.getpeercert(binary_form=True), first)
        self.show(sender, early + late)
        self.stop([sender, *early, *late])

    def test_all_messages_of_one_record_are_read(self):
        question = json.dumps({"op": "ping", "id": 1, "time_us": 0}).ljust(500).encode()
        for path in ("/v1/subscribe", "/v1/subscribe", "/v1/publish/b"):  # One viewer in each loop.
            peer = self.connect(path)
            peer.send(*[frame(TEXT, question)] * 30)  # TLS takes 16 KiB at a time.
            for _ in range(30):
                next_control(peer, "pong")
            peer.sock.close()

    def test_assets_come_and_go_beside_both_loops(self):
        sender = self.publish()
        viewers = self.watch(4)
        body = random.Random(1).randbytes(2_000_000)
        name = hashlib.sha256(body).hexdigest()
        path = f"/v1/assets/{name}"
        torn = Peer(self.port, upgrade=False, tls=self.tls)
        torn.send(f"PUT {path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: {len(body)}\r\n\r\n".encode(), body[:700_000])
        self.show(sender, viewers)
        torn.sock.close()
        self.assertEqual(self.request("GET", path)[0], 404, "what came in half is nothing")
        self.assertEqual(self.request("PUT", path, body[:-1])[0], 422)
        self.assertEqual(self.request("PUT", path, body)[0], 201)
        self.assertEqual(self.request("PUT", path, body)[0], 200)

        status, headers, begin = self.request("GET", path, Range="bytes=0-699999")
        self.assertEqual((status, headers["Content-Range"]), (206, f"bytes 0-699999/{len(body)}"))
        status, _, rest = self.request("GET", path, Range="bytes=700000-", If_Range=headers["ETag"])
        self.assertEqual(status, 206)
        self.assertEqual(begin + rest, body)
        self.assertEqual(self.request("GET", path, Range="bytes=700000-", If_Range='"another"')[2], body)
        self.assertEqual(self.request("GET", path, Range=f"bytes={len(body)}-")[0], 416)

        got = []
        crowd = [threading.Thread(target=lambda: got.append(self.request("GET", path)[2] == body)) for _ in range(6)]
        for one in crowd:
            one.start()
        self.show(sender, viewers, KEYS)
        for one in crowd:
            one.join()
        self.assertEqual(got, [True] * len(crowd))
        self.assertRegex(self.ask("/metrics"), r"eigencast_broker_uploads 0\n")
        self.stop([sender, *viewers])

    def test_orders_find_their_clients_in_either_loop(self):
        sender = self.publish()
        viewers = self.watch(6)
        self.show(sender, viewers)
        clients = [client["id"] for client in json.loads(self.ask("/api/clients"))["clients"] if client["kind"] == "viewer"]
        self.assertEqual(clients, sorted(clients))
        gone, stay = viewers[:4], viewers[4:]
        for viewer, client in zip(gone, clients):
            self.ask(f"/api/clients/kick?id={client}", order=True)
            self.assertEqual(closed_with(viewer), 1008, "the one of that id, and nobody else")
        self.show(sender, stay)
        self.stop([sender, *stay], by_order=True)


if __name__ == "__main__":
    BROKER = sys.argv.pop(1)
    cases.main()
