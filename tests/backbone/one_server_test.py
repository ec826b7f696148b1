#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Brokers of one machine over one NATS server: which are admitted, what it forgets, and a broker that ends while messages pour in.

    one_server_test.py FOLDER-OF-PROGRAMS CLOCK [-v]       CLOCK: the library of tests/support/stepped_clock.cpp, or -

Skipped without nats-server.
"""
import json
import os
import pathlib
import re
import shutil
import signal
import socket
import ssl
import struct
import subprocess
import sys
import tempfile
import threading
import time
import unittest
import urllib.request

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/support"), str(ROOT / "bench/broker"), str(pathlib.Path(__file__).parent)]
import cases
import nats_users
import payloads
from websocket_peer import BINARY, TEXT, Peer, frame, free_ports, ports_of

PROGRAMS = CLOCK = None


class Sender(threading.Thread):
    """Announces stream s at a broker of this machine, is granted, and sends until `over`."""

    def __init__(self, port):
        super().__init__(daemon=True)
        body, self.asset = payloads.asset()
        urllib.request.urlopen(urllib.request.Request(f"http://127.0.0.1:{port}/v1/assets/{self.asset}", data=body, method="PUT")).close()
        self.template, rows = payloads.float_join(600)
        self.peer = Peer(port, "/v1/publish/s", "eigencast.v2")
        self.peer.send(frame(TEXT, payloads.announce(self.asset, rows, "float32").encode()))
        while b'"announced"' not in (text := self.peer.receive()[1]):
            pass
        self.tag = json.loads(text)["tag"]
        self.body, self.over = body, threading.Event()
        self.start()

    def run(self):
        sequence = 0
        while not self.over.wait(0.02):
            self.peer.send(frame(BINARY, payloads.stamped(self.template, sequence, 20_000 * sequence + 1, self.tag)))
            sequence += 1

    def end(self):
        self.over.set()
        self.join()
        self.peer.sock.close()


class OneServer(unittest.TestCase):
    """One NATS server that authenticates its clients, over TLS, and brokers; all on loopback."""

    SERVER = """
listen: "127.0.0.1:{port}"
jetstream {{ store_dir: "{folder}/jetstream" }}
tls {{ cert_file: "{folder}/server.pem", key_file: "{folder}/server.key", ca_file: "{folder}/ca.pem", verify: {verify} }}
{rest}
"""
    # No more rights than docs/scaling.md says.
    PASSWORD = """authorization { users: [ { user: broker, password: secret, permissions: {
  publish: ["eigencast.>", "_INBOX.>", "$JS.API.>", "$KV.eigencast_streams.>"], subscribe: ["eigencast.>", "_INBOX.>"] } } ] }"""

    nats = None

    def setUp(self):
        if not shutil.which("nats-server"):
            self.skipTest("no nats-server")
        self.folder = tempfile.mkdtemp(prefix="eigencast-guarded-")
        self.addCleanup(shutil.rmtree, self.folder)
        make = lambda *words: subprocess.run(["openssl", *words], cwd=self.folder, check=True, capture_output=True)
        curve = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
        make("req", "-x509", *curve, "-keyout", "ca.key", "-out", "ca.pem", "-days", "2", "-subj", "/CN=test")
        pathlib.Path(self.folder, "names").write_text("subjectAltName=DNS:localhost")
        for name in ("server", "broker"):
            make("req", *curve, "-keyout", f"{name}.key", "-out", f"{name}.csr", "-subj", "/CN=localhost")
            make("x509", "-req", "-in", f"{name}.csr", "-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial", "-days", "2", "-out", f"{name}.pem",
                 "-extfile", "names")

    def start_nats(self, rest, verify="false"):
        if self.nats is None:
            self.nats, = free_ports(1)
        config = pathlib.Path(self.folder, "nats.conf")
        config.write_text(self.SERVER.format(port=self.nats, folder=self.folder, rest=rest, verify=verify))
        self.log = pathlib.Path(self.folder, "nats.log")
        server = subprocess.Popen(["nats-server", "-c", config], stderr=open(self.log, "w"))
        self.addCleanup(server.wait)
        self.addCleanup(server.terminate)
        return server

    def broker(self, name, ca="ca.pem", environment={}, **shown):
        """Its data port and a way to ask its admin port. `shown`: settings of [backbone] with which it shows who it is."""
        ports = pathlib.Path(self.folder, f"ports-{name}")
        process = subprocess.Popen(
            [PROGRAMS / "eigencast-broker", "--listen=127.0.0.1:0", "--admin-listen=127.0.0.1:0", f"--port-file={ports}",
             f"--data-dir={self.folder}/data-{name}", "--log-level=error", *([f"--backbone-ca={ca}"] if ca else [])],
            env={**os.environ, "EIGENCAST_BACKBONE__SERVERS": f"tls://localhost:{self.nats}", **environment, **{f"EIGENCAST_BACKBONE__{key.upper()}": value for key, value in shown.items()}, "CREDENTIALS_DIRECTORY": self.folder})
        self.addCleanup(self.end, process)
        data, admin = ports_of(ports)
        return data, lambda path: urllib.request.urlopen(f"http://127.0.0.1:{admin}{path}", timeout=5).read().decode()

    def end(self, process):
        process.terminate()
        self.assertEqual(process.wait(60), 0, "a broker that is told to end does so well")

    def wait_for(self, condition, what):
        for _ in range(1200):
            if condition():
                return
            time.sleep(0.05)
        self.fail(f"{what}\n{self.log.read_text()[-2000:]}")

    def meet(self, count=2, **shown):
        """The data ports of brokers that have heard of each other."""
        brokers = [self.broker(f"broker-{number}", **shown) for number in range(count)]
        for _, ask in brokers:
            self.wait_for(lambda: f"\neigencast_broker_backbone_brokers {count}\n" in ask("/metrics"), "they do not meet")
        return [port for port, _ in brokers]

    def sender(self, port):
        """Refused for a moment where the one before it, at another broker, has just gone: tries again, as senders do."""
        for _ in range(1200):
            try:
                sender = Sender(port)
            except EOFError:
                time.sleep(0.05)
                continue
            self.addCleanup(sender.end)
            return sender
        self.fail("the sender is refused")

    def assert_degraded(self, ask):
        self.assertEqual(json.loads(ask("/api/broker"))["state"], "degraded")
        self.assertIn("\neigencast_broker_backbone_connected 0\n", ask("/metrics"))

    def assert_frames_come(self, viewer, seconds=60):
        viewer.sock.settimeout(seconds)
        while viewer.receive()[0] != BINARY:
            pass


class Guarded(OneServer):
    def assert_streams_cross(self, **shown):
        one, two = self.meet(**shown)
        sender = self.sender(one)
        self.assert_frames_come(Peer(two, "/v1/subscribe/s?rate=raw", "eigencast.v2"))
        fetched = urllib.request.urlopen(f"http://127.0.0.1:{two}/v1/assets/{sender.asset}").read()
        self.assertEqual(fetched, sender.body)
        self.assertNotIn("Violation", self.log.read_text())

    def test_streams_cross_with_a_password_and_few_rights(self):
        self.start_nats(self.PASSWORD)
        self.assert_streams_cross(user="broker", password="secret")

    def test_streams_cross_with_a_token(self):
        self.start_nats('authorization { token: "a secret" }')
        self.assert_streams_cross(token="a secret")

    def test_streams_cross_with_a_certificate(self):
        self.start_nats("", verify="true")
        self.assert_streams_cross(certificate="broker.pem", key="broker.key")

    def test_streams_cross_with_signed_credentials(self):
        credentials, server = nats_users.make(self.folder)
        pathlib.Path(self.folder, "broker.creds").write_text(credentials)
        self.start_nats(server)
        self.assert_streams_cross(credentials="broker.creds")

    def test_a_refused_broker_serves_on_degraded(self):
        self.start_nats(self.PASSWORD)
        for password, ca in (("wrong", "ca.pem"), ("secret", "server.pem")):
            _, ask = self.broker(f"{password}-{ca}", ca, user="broker", password=password)
            self.assert_degraded(ask)


class Rogue:
    """A client of the NATS server that says what it likes."""

    def __init__(self, test, user, password):
        sock = socket.create_connection(("127.0.0.1", test.nats), timeout=60)
        while not sock.recv(4096).endswith(b"\r\n"):
            pass
        context = ssl.create_default_context(cafile=f"{test.folder}/ca.pem")
        self.sock, self.heard = context.wrap_socket(sock, server_hostname="localhost"), b""
        self.sock.sendall(f'CONNECT {{"verbose":false,"tls_required":true,"user":"{user}","pass":"{password}"}}\r\n'.encode())
        self.settle()

    def publish(self, subject, data, reply=""):
        self.sock.sendall(f"PUB {subject} {reply} {len(data)}\r\n".encode() + data + b"\r\n")

    def settle(self):
        """Everything until the server has done what it was asked."""
        self.sock.sendall(b"PING\r\n")
        begin = len(self.heard)
        while b"PONG\r\n" not in self.heard[begin:]:
            self.heard += self.sock.recv(65536)
        return self.heard[begin:]


class Trusted(OneServer):
    def test_the_shipped_permissions_suffice_and_pin_each_broker(self):
        for name in ("edge-1", "edge-2"):
            os.environ[name.upper().replace("-", "_") + "_PASSWORD"] = f"secret_of_{name}"
        self.start_nats((ROOT / "deploy/nats/brokers.conf").read_text())
        brokers = [self.broker(name, environment={"EIGENCAST_BACKBONE__NAME": name}, user=name, password=f"secret_of_{name}") for name in ("edge-1", "edge-2")]
        for _, ask in brokers:
            self.wait_for(lambda: "2 brokers" in ask("/api/broker"), "they do not meet")
        sender = self.sender(brokers[0][0])
        self.assert_frames_come(Peer(brokers[1][0], "/v1/subscribe/s?rate=raw", "eigencast.v2"))
        sender.end()
        self.sender(brokers[1][0])  # It moves.
        self.assert_frames_come(Peer(brokers[0][0], "/v1/subscribe/s?rate=raw", "eigencast.v2"))
        self.assertNotIn("Violation", self.log.read_text())
        rogue = Rogue(self, "edge-2", "secret_of_edge-2")
        for subject in ("alive.edge-1.x", "rows.edge-1.x", "frames.edge-1.x.s"):
            rogue.publish(f"eigencast.{subject}", b"-")
            self.assertIn(b"Permissions Violation", rogue.settle(), subject)
        for subject in ("_INBOX.>", "eigencast.joins.edge-1.*", "eigencast.assets.>"):
            rogue.sock.sendall(f"SUB {subject} 1\r\n".encode())
            self.assertIn(b"Permissions Violation", rogue.settle(), subject)
        for request in ("LIST", "NAMES", "INFO", "DURABLE.CREATE"):  # They show, or guess, where others await rows.
            rogue.publish(f"$JS.API.CONSUMER.{request}.KV_eigencast_streams", b"")
            self.assertIn(b"Permissions Violation", rogue.settle(), request)
        # JetStream answers to any subject, whose message is no broker's then.
        rogue.sock.sendall(b"SUB eigencast.alive.> 1\r\n")
        for request in ("$JS.API.STREAM.NAMES", "$KV.eigencast_streams.x"):
            rogue.publish(request, b"", reply=f"eigencast.alive.edge-1.by{request.count('.')}")
        self.wait_for(lambda: all(f" eigencast.alive.edge-1.by{n} ".encode() in rogue.settle() + rogue.heard for n in (2, 3)), "it answers")
        rogue.publish("eigencast.alive.edge-2.known", b"+")
        ask = brokers[0][1]
        self.wait_for(lambda: "2 brokers" not in ask("/api/broker"), "its own heartbeat comes")
        self.assertIn("3 brokers", ask("/api/broker"))

    def test_a_peer_that_speaks_for_others_is_not_believed(self):
        who = {"user": "broker", "password": "secret"}
        self.start_nats(self.PASSWORD)
        (one, _), (two, ask) = (self.broker(name, **who) for name in ("broker-0", "broker-1"))
        self.wait_for(lambda: "2 brokers" in ask("/api/broker"), "they do not meet")
        sender = self.sender(one)
        viewer = Peer(two, "/v1/subscribe/s?rate=raw", "eigencast.v2")
        self.assert_frames_come(viewer)
        rogue = Rogue(self, "broker", "secret")
        rogue.sock.sendall(b"SUB eigencast.rows.> 1\r\nSUB eigencast.frames.> 2\r\n")
        self.wait_for(lambda: b" eigencast.frames." in rogue.settle() + rogue.heard, "frames have an owner")
        owner = re.search(rb"eigencast\.frames\.([^ ]+)\.s ", rogue.heard)[1].decode()
        _, rows = payloads.float_join(600)
        entry = {"owner": owner, "epoch": 1 << 31, "live": False, "announce": payloads.announce(sender.asset, rows, "float32")}
        row = lambda revision, key, text: struct.pack("<QBH", revision, 1, len(key)) + key + json.dumps(text).encode()
        rogue.publish("eigencast.rows.evil.1", row((1 << 63) + 1, b"s", entry))
        rogue.publish("eigencast.frames.evil.1.s", b"no frame")
        for number in range(2000):
            rogue.publish(f"eigencast.alive.evil.{number}", b"+")
            rogue.publish("eigencast.rows.evil.1", row(1 << 62, f"invented-{number}".encode(), entry))
        rogue.settle()
        brokers = lambda: int(re.search(r"\neigencast_broker_backbone_brokers (\d+)", ask("/metrics"))[1])
        self.wait_for(lambda: brokers() > 100, "its heartbeats come")
        self.assertLessEqual(brokers(), 2 + 256)
        self.assertIn("\neigencast_broker_backbone_streams_known 1\n", ask("/metrics"))
        for _ in range(100):
            opcode, payload = viewer.receive()
            self.assertFalse(opcode == TEXT and b'"stalled"' in payload, payload)


class Plain(threading.Thread):
    """Answers as a NATS server without TLS does, and keeps what it is sent."""

    def __init__(self):
        super().__init__(daemon=True)
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port, self.taken, self.tries = self.listener.getsockname()[1], b"", 0
        self.start()

    def run(self):
        while True:
            try:
                peer, _ = self.listener.accept()
            except OSError:
                return
            peer.settimeout(60)
            try:
                peer.sendall(b'INFO {"server_id":"a","version":"2.9.0","proto":1,"headers":true,"max_payload":1048576,"jetstream":true}\r\n')
                while data := peer.recv(4096):
                    self.taken += data
                    if b"PING" in data:
                        peer.sendall(b"PONG\r\n")
            except OSError:
                pass
            self.tries += 1
            peer.close()


class Mute(threading.Thread):
    """A NATS server that falls silent: at once, after INFO, or in the TLS handshake that its INFO asks for."""

    def __init__(self, said):
        super().__init__(daemon=True)
        self.said, self.peers, self.waited_for = said, [], threading.Event()
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        self.start()

    def run(self):
        while True:
            try:
                peer, _ = self.listener.accept()
                self.peers.append(peer)  # Stays open.
                peer.sendall(self.said)
                if not self.said or peer.recv(1):
                    self.waited_for.set()
            except OSError:
                return


class Silenced(OneServer):
    INFO = b'INFO {"server_id":"a","version":"2.9.0","proto":1,"headers":true,"max_payload":1048576%s}\r\n'

    def test_a_mute_server_holds_up_neither_start_nor_streams_nor_end(self):
        for said in (b"", self.INFO % b"", self.INFO % b',"tls_required":true'):
            with self.subTest(said=said):
                mute = Mute(said)
                self.log = pathlib.Path(os.devnull)
                process = self.lone_broker(mute.port)
                data, admin = ports_of(pathlib.Path(self.folder, f"ports-{mute.port}"))
                self.assertTrue(mute.waited_for.wait(60), "the broker tries")
                viewer = Peer(data, "/v1/subscribe/s?rate=raw", "eigencast.v2")
                sender = Sender(data)
                self.assert_frames_come(viewer)
                sender.end()
                ask = lambda: urllib.request.urlopen(f"http://127.0.0.1:{admin}/readyz", timeout=60).read()
                self.assertTrue(ask().startswith(b"ready, degraded"))
                process.terminate()
                self.assertEqual(process.wait(60), 0)
                mute.listener.close()

    def lone_broker(self, nats):
        process = subprocess.Popen(
            [PROGRAMS / "eigencast-broker", "--listen=127.0.0.1:0", "--admin-listen=127.0.0.1:0", f"--port-file={self.folder}/ports-{nats}",
             f"--data-dir={self.folder}/data-{nats}", "--log-level=error", f"--backbone-servers=nats://127.0.0.1:{nats}"])
        self.addCleanup(process.wait)
        self.addCleanup(process.kill)
        return process


class Secured(OneServer):
    def test_tls_servers_are_never_spoken_to_in_plain_text(self):
        plain = Plain()
        self.addCleanup(plain.listener.close)
        self.nats, self.log = plain.port, pathlib.Path(os.devnull)
        for number, servers in enumerate((f"tls://localhost:{plain.port}", f"tls://localhost:1,nats://localhost:{plain.port}")):
            tried = plain.tries
            _, ask = self.broker(f"lured-{number}", "", {"EIGENCAST_BACKBONE__SERVERS": servers}, token="a secret")
            self.wait_for(lambda: plain.tries > tried, "the broker does not try")
            self.assert_degraded(ask)
        self.assertNotIn(b"CONNECT", plain.taken)
        self.assertNotIn(b"secret", plain.taken)

    def test_the_authorities_of_the_system_vouch_without_a_ca(self):
        self.start_nats(self.PASSWORD)
        who = {"user": "broker", "password": "secret"}
        _, ask = self.broker("stranger", "", **who)
        self.assert_degraded(ask)
        _, ask = self.broker("known", "", {"SSL_CERT_FILE": f"{self.folder}/ca.pem"}, **who)
        self.wait_for(lambda: json.loads(ask("/api/broker"))["state"] == "ok", "a certificate of a known authority is refused")

    def test_a_certificate_of_another_name_is_refused(self):
        self.start_nats(self.PASSWORD)
        _, ask = self.broker("misled", environment={"EIGENCAST_BACKBONE__SERVERS": f"tls://127.0.0.1:{self.nats}"}, user="broker", password="secret")
        self.assert_degraded(ask)


class Forgotten(OneServer):
    def test_a_directory_that_is_lost_is_written_anew(self):
        who = {"user": "broker", "password": "secret"}
        server = self.start_nats(self.PASSWORD)
        one, two = self.meet(**who)
        self.sender(one).end()
        sender = self.sender(one)  # Not the first: the revision of the stream's entry has grown.
        self.assert_frames_come(Peer(two, "/v1/subscribe/s?rate=raw", "eigencast.v2"))
        server.kill()
        server.wait()
        shutil.rmtree(pathlib.Path(self.folder, "jetstream"))
        self.start_nats(self.PASSWORD)
        three, ask = self.broker("broker-3", **who)
        self.wait_for(lambda: "\neigencast_broker_backbone_brokers 3\n" in ask("/metrics"), "they do not meet again")
        self.assert_frames_come(Peer(three, "/v1/subscribe/s?rate=raw", "eigencast.v2"))
        self.assert_frames_come(Peer(two, "/v1/subscribe/s?rate=raw", "eigencast.v2"))
        sender.end()
        self.sender(two)  # It moves, and is known.
        self.assert_frames_come(Peer(three, "/v1/subscribe/s?rate=raw", "eigencast.v2"))


class SetBack(OneServer):
    """libnats waits until times of the wall clock."""

    def test_a_silent_server_is_noticed_by_a_broker_whose_clock_was_set_back(self):
        if CLOCK == "-":
            self.skipTest("a sanitizer wants to be loaded before the clock")
        offset = pathlib.Path(self.folder, "clock")
        offset.write_bytes((40_000).to_bytes(8, "little"))  # Their certificates are valid from now on, for two days.
        who = {"user": "broker", "password": "secret"}
        server = self.start_nats(self.PASSWORD)
        self.addCleanup(server.send_signal, signal.SIGCONT)
        one, ask = self.broker("broker-1", environment={"LD_PRELOAD": CLOCK, "EIGENCAST_TEST_CLOCK": str(offset)}, **who)
        two, _ = self.broker("broker-2", **who)
        self.wait_for(lambda: "2 brokers" in ask("/api/broker"), "they do not meet")
        with open(offset, "r+b") as file:
            file.write(bytes(8))
        sender = self.sender(two)
        self.assert_frames_come(Peer(one, "/v1/subscribe/s?rate=raw", "eigencast.v2"))
        server.send_signal(signal.SIGSTOP)
        self.wait_for(lambda: "degraded" in ask("/readyz"), "its pings wait for half a day")
        server.send_signal(signal.SIGCONT)
        self.wait_for(lambda: ask("/readyz").strip() == "ready", "it does not connect again")
        sender.end()  # And broker() sees that the broker ends.


class Ending(unittest.TestCase):
    def test_a_broker_ends_well_while_messages_pour_in(self):
        if not shutil.which("nats-server"):
            self.skipTest("no nats-server")
        folder = pathlib.Path(tempfile.mkdtemp(prefix="eigencast-ending-"))
        self.addCleanup(shutil.rmtree, folder)
        port, = free_ports(1)
        nats = subprocess.Popen(["nats-server", "-a", "127.0.0.1", "-p", str(port), "-js", "-sd", folder / "jetstream"], stderr=subprocess.DEVNULL)
        self.addCleanup(nats.wait)
        self.addCleanup(nats.terminate)
        over = threading.Event()
        self.addCleanup(over.set)

        def pour():
            while not over.is_set():
                try:
                    with socket.create_connection(("127.0.0.1", port)) as sock:
                        sock.sendall(b'CONNECT {"verbose":false}\r\n')
                        while not over.wait(0.001):
                            sock.sendall(b"PUB eigencast.alive 3\r\n+ab\r\n" * 50)
                except OSError:
                    over.wait(0.1)
        threading.Thread(target=pour, daemon=True).start()
        for run in range(10):
            self.start_and_end_brokers(folder, port, [f"{run}-{number}" for number in range(4)])

    def start_and_end_brokers(self, folder, nats, names):
        brokers = []
        for name in names:
            process = subprocess.Popen([PROGRAMS / "eigencast-broker", "--listen=127.0.0.1:0", "--admin-listen=127.0.0.1:0",
                                        f"--port-file={folder}/ports-{name}", f"--data-dir={folder}/data-{name}", "--log-level=error",
                                        f"--backbone-servers=nats://127.0.0.1:{nats}"])
            self.addCleanup(process.kill)
            brokers.append((process, folder / f"ports-{name}"))
        for _, ports in brokers:
            url = f"http://127.0.0.1:{ports_of(ports)[1]}/metrics"
            while "\neigencast_broker_backbone_connected 1" not in urllib.request.urlopen(url, timeout=20).read().decode():
                time.sleep(0.02)
        for process, _ in brokers:
            process.terminate()
        for process, _ in brokers:
            self.assertEqual(process.wait(60), 0)


if __name__ == "__main__":
    PROGRAMS, CLOCK = pathlib.Path(sys.argv.pop(1)).resolve(), sys.argv.pop(1)
    cases.main()
