#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""What strangers may take, keep and see, asked from outside: assets, the admin port, the log, files, TLS; how it ends.

    http_access_test.py BROKER [-v]
"""
import base64
import collections
import contextlib
import fcntl
import hashlib
import hmac
import http.client
import itertools
import json
import os
import pathlib
import random
import re
import select
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

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/support"), str(ROOT / "bench/broker")]
import cases
import payloads
from websocket_peer import BINARY, CLOSE, PING, PONG, TEXT, Broker, Peer, frame, ports_of

BROKER = None


def own_address():
    """An address of this machine that is not loopback; empty: it has none."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # Sends nothing.
        except OSError:
            return ""
        return probe.getsockname()[0]


def ask(port, method, target, body=None, host="127.0.0.1", source=None, headers={}):
    """Status, headers and body of one answer; `source`: the address that it is asked from, if not `host`."""
    connection = http.client.HTTPConnection(host, port, timeout=60, source_address=(source or host, 0))
    try:
        connection.request(method, target, body, headers)
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read().decode()
    finally:
        connection.close()


def asset_of(body):
    return "/v1/assets/" + hashlib.sha256(body).hexdigest()


def signed_token(secret, claims):
    text = lambda raw: base64.urlsafe_b64encode(raw).rstrip(b"=")
    signed = b".".join(text(json.dumps(part).encode()) for part in ({"alg": "HS256"}, claims))
    return (signed + b"." + text(hmac.digest(secret.encode(), signed, "sha256"))).decode()


class SlowUpload:
    """An upload that is begun and not finished; reads its answer, 100 if the broker waits for the rest."""

    def __init__(self, port, token=None):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=60)
        head = ["PUT " + asset_of(b"never sent") + " HTTP/1.1", "Host: localhost", "Content-Length: 1000000", "Expect: 100-continue"]
        if token:
            head.append("Authorization: Bearer " + token)
        self.socket.sendall(("\r\n".join(head) + "\r\n\r\n").encode())
        first = self.socket.recv(4096)
        self.status = int(first.split()[1])
        self.answer = (first if self.status == 100 else first + self.rest()).decode()

    def rest(self):
        return b"".join(iter(lambda: self.socket.recv(4096), b""))

    def trickle(self):
        """Sends a byte now and then until the broker answers, and returns its answer."""
        while True:
            self.socket.settimeout(0.05)
            with contextlib.suppress(TimeoutError):
                first = self.socket.recv(4096)
                self.socket.settimeout(60)
                return (first + self.rest()).decode()
            self.socket.sendall(b"x")


SECRET = "a secret of the tests, of more than 32 bytes"


def token(subject):
    """A signed token for all streams."""
    rights = {"pub": ["**"], "sub": ["**"]}
    return signed_token(SECRET, {"sub": subject, "aud": "eigencast", "exp": int(time.time()) + 3600, "eigencast": rights})


def connect(port, path, subject=None):
    """A WebSocket, of a token or of nobody."""
    return Peer(port, path, "eigencast.v2", [f"Authorization: Bearer {token(subject)}"] if subject else [])


def order(peer, op, **fields):
    peer.send(frame(TEXT, json.dumps({"op": op, **fields}).encode()))


def hear(peer, *ops):
    """The next message of one of these ops."""
    while True:
        opcode, payload = peer.receive()
        message = json.loads(payload) if opcode == TEXT else {"op": "closed", "code": int.from_bytes(payload[:2], "big")}
        if message["op"] in (*ops, "closed"):
            return message


def announce(port, stream, subject=None):
    """A sender, and what its announcement was answered."""
    sender = connect(port, f"/v1/publish/{stream}", subject)
    sender.send(frame(TEXT, payloads.announce(payloads.asset()[1], 4, "float32").encode()))
    return sender, hear(sender, "announced", "error")


def state_of(port, stream):
    viewer = connect(port, f"/v1/subscribe/{stream}")
    try:
        return hear(viewer, "stream")["state"]
    finally:
        viewer.sock.close()


def flap(port, streams, subject=None):
    """Senders that come and go, each under a new name."""
    for stream in streams:
        sender, answer = announce(port, stream, subject)
        assert answer["op"] == "announced", answer
        sender.sock.close()


def tls_client():
    """A context that trusts any server."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    return context


def client_hello(context):
    """The record that begins a handshake."""
    received, sent = ssl.MemoryBIO(), ssl.MemoryBIO()
    with contextlib.suppress(ssl.SSLWantReadError):
        context.wrap_bio(received, sent).do_handshake()
    return sent.read()


@contextlib.contextmanager
def takes_at_least(test, seconds, why):
    """By a budget: on no machine it is sooner."""
    started = time.monotonic()
    yield
    test.assertGreater(time.monotonic() - started, seconds, why)


class HttpAccess(unittest.TestCase):
    def start(self, *flags):
        self.broker = Broker(BROKER, *flags)
        self.addCleanup(self.broker.__exit__)
        return ports_of(pathlib.Path(self.broker.folder) / "port")

    def slow_upload(self, *arguments):
        upload = SlowUpload(*arguments)
        self.addCleanup(upload.socket.close)
        return upload

    def refused_after(self, port, most):
        """How many objects of 8 bytes the broker takes; the answer to the next."""
        for count in range(most):
            body = f"{count:8}".encode()
            status, _, text = ask(port, "PUT", asset_of(body), body)
            if status != 201:
                return count, status, text
        self.fail(f"{most} objects are taken")

    def test_small_objects_are_charged_what_the_disk_takes(self):
        quota = 1 << 20
        port, admin = self.start(f"--assets-max-total-bytes={quota}")
        count, status, text = self.refused_after(port, 1000)
        self.assertEqual(status, 507)
        self.assertIn("assets.max_total_bytes", text)
        on_disk = sum(os.stat(file).st_blocks * 512 for file in pathlib.Path(self.broker.folder, "assets").rglob("*") if file.is_file())
        self.assertLessEqual(on_disk, quota)
        self.assertGreater(count, quota // 5000, "not charged much more than that")
        self.assertEqual(ask(port, "GET", asset_of(b"       0"))[0], 200)

    def test_objects_are_counted(self):
        port, _ = self.start("--assets-max-objects=20")
        count, status, text = self.refused_after(port, 100)
        self.assertEqual((count, status), (20, 507))
        self.assertIn("assets.max_objects", text)

    def test_one_address_keeps_its_share_of_the_store_only(self):
        port, _ = self.start("--assets-max-objects=20")
        put = lambda body, source: ask(port, "PUT", asset_of(body), body, source=source)[0]
        self.assertEqual(self.refused_after(port, 100)[:2], (20, 507), "alone it may fill it")
        others = [f"other {count}".encode() for count in range(10)]
        self.assertEqual([put(body, "127.0.0.2") for body in others], 10 * [201])
        self.assertEqual(put(b"more", "127.0.0.2"), 507, "what was used a moment ago stays, up to a share")
        self.assertEqual(put(b"more", "127.0.0.1"), 507)
        self.assertEqual([ask(port, "GET", asset_of(body))[0] for body in others], 10 * [200])

    def test_one_address_does_not_hold_all_uploads(self):
        port, admin = self.start()
        held = [self.slow_upload(port) for _ in range(100)]
        body = b"of another address"
        self.assertEqual(ask(port, "PUT", asset_of(body), body, source="127.0.0.2")[0], 201)
        self.assertEqual([upload.status for upload in held], 8 * [100] + 92 * [429])
        self.assertIn("per_address.uploads = 8", held[-1].answer)
        self.assertIn("\neigencast_broker_uploads 8\n", ask(admin, "GET", "/metrics")[2])
        held[0].socket.close()
        for _ in itertools.count():  # The broker may hear of it a moment later.
            if ask(port, "PUT", asset_of(body), body)[0] == 200:
                break

    def test_uploads_in_all_are_limited(self):
        port, _ = self.start("--limits-max-uploads=2")
        self.assertEqual([self.slow_upload(port).status for _ in range(3)], [100, 100, 503])

    def test_an_upload_has_a_deadline(self):
        port, _ = self.start("--timeouts-upload-ms=1000")
        answer = self.slow_upload(port).trickle()
        self.assertIn(" 408 ", answer)
        self.assertIn("timeouts.upload_ms", answer)

    def test_an_upload_ends_when_its_token_expires(self):
        secret = "a secret of the tests, of more than 32 bytes"
        port, _ = self.start(f"--access-jwt-secret={secret}", "--access-jwt-leeway-s=0")
        for lives_s in itertools.count(3):  # A busy machine may let it expire before the upload begins.
            token = signed_token(secret, {"sub": "camera", "aud": "eigencast", "eigencast": {"pub": ["**"]}, "exp": int(time.time()) + lives_s})
            upload = self.slow_upload(port, token)
            if upload.status == 100:
                break
        answer = upload.trickle()
        self.assertIn(" 401 ", answer)
        self.assertIn('error="invalid_token"', answer)

    def fixed_token(self):
        """A file of tokens, and the one in it."""
        made = subprocess.run([BROKER, "token", "create", "--static", "--subject=camera", "--publish=**"], check=True, capture_output=True, text=True)
        tokens = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()), "tokens")
        tokens.touch(0o600)
        tokens.write_text(made.stderr.splitlines()[-1] + "\n")
        return tokens, made.stdout.strip()

    def test_a_delayed_request_has_the_rights_of_when_it_is_answered(self):
        tokens, token = self.fixed_token()
        known, config = tokens.read_text(), tokens.with_name("eigencast.toml")
        begin = lambda: (tokens.write_text(known), config.write_text('[access]\norigins = ["https://page.example"]\n'))
        begin()
        port, admin = self.start(f"--config={config}", f"--access-tokens-file={tokens}", "--per-address-requests-per-s=1", "--per-token-requests-per-s=1")

        def reload():
            count = lambda: re.search(r"^eigencast_broker_reloads_total (\d+)", ask(admin, "GET", "/metrics")[2], re.M)[1]
            before = count()
            self.broker.process.send_signal(signal.SIGHUP)
            while count() == before:
                time.sleep(0.01)

        for header, change, status in ((f"Authorization: Bearer {token}", lambda: tokens.write_text(""), 401),
                                       ("Origin: https://page.example", lambda: config.write_text(""), 403),
                                       ("Accept: */*", lambda: config.write_text('[access]\nanonymous = "nowhere"\n'), 401)):
            late = set()
            while not late:  # On a busy machine all may be answered before the reload.
                begin()
                reload()
                asked = [socket.create_connection(("127.0.0.1", port), timeout=60) for _ in range(5)]
                for one in asked:
                    self.addCleanup(one.close)
                    one.sendall(f"GET /v1/streams HTTP/1.1\r\nHost: localhost\r\n{header}\r\n\r\n".encode())
                select.select(asked, [], [])  # The others wait their turn.
                change()
                reload()
                waited = set(asked) - set(select.select(asked, [], [], 0)[0])
                late = {int(one.recv(4096).split()[1]) for one in waited} - {429}
            self.assertEqual(late, {status}, header)

    def test_an_upload_ends_when_its_token_is_revoked(self):
        tokens, token = self.fixed_token()
        port, _ = self.start(f"--access-tokens-file={tokens}")
        upload, stranger = self.slow_upload(port, token), self.slow_upload(port)
        self.assertEqual((upload.status, stranger.status), (100, 100))
        tokens.write_text("# taken out\n")
        self.broker.process.send_signal(signal.SIGHUP)
        self.assertIn(" 401 ", upload.trickle())
        stranger.socket.settimeout(0.05)
        self.assertRaises(TimeoutError, stranger.socket.recv, 4096)

    def test_a_download_ends_when_its_token_is_revoked(self):
        tokens, token = self.fixed_token()
        port, admin = self.start(f"--access-tokens-file={tokens}")
        body, auth = bytes(64 << 20), {"Authorization": f"Bearer {token}"}
        self.assertEqual(ask(port, "PUT", asset_of(body), body, headers=auth)[0], 201)
        lost = socket.socket()
        self.addCleanup(lost.close)
        lost.settimeout(60)
        lost.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        lost.connect(("127.0.0.1", port))
        lost.sendall(f"GET {asset_of(body)} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {token}\r\n\r\n".encode())
        self.assertIn(b" 200 ", lost.recv(1000))
        tokens.write_text("# taken out\n")
        self.broker.process.send_signal(signal.SIGHUP)
        while "eigencast_broker_reloads_total 1" not in ask(admin, "GET", "/metrics")[2]:
            time.sleep(0.01)
        rest = 0
        with contextlib.suppress(ConnectionResetError):
            while part := lost.recv(1 << 20):
                rest += len(part)
        self.assertLess(rest, len(body) // 2, "what the kernel had taken")

    def test_one_address_leaves_connections_of_the_admin_port_to_others(self):
        _, admin = self.start()
        held = [socket.create_connection(("127.0.0.1", admin), timeout=60) for _ in range(100)]
        for one in held:
            self.addCleanup(one.close)
        refused = set()
        while len(refused) < 80:
            ready = select.select(set(held) - refused, [], [], 60)[0]
            self.assertTrue(ready, "those beyond its share are closed at once")
            for one in ready:
                self.assertIn(b" 429 ", one.recv(4096))
                refused.add(one)
        self.assertEqual(ask(admin, "GET", "/livez", source="127.0.0.2")[0], 200)
        for one in held:
            one.close()
        while ask(admin, "GET", "/livez")[0] != 200:
            time.sleep(0.01)  # Until the broker has noticed.

    def test_a_claimed_or_rebound_address_is_not_local(self):
        data, admin = self.start("--proxy-trusted=127.0.0.0/8", "--access-monitors=127.0.0.0/8", "--access-hosts=broker")
        for port, target in ((data, "/v1/streams"), (admin, "/api/clients"), (admin, "/metrics")):
            for good in ({}, {"Host": "localhost:1"}, {"Host": "[::1]"}, {"Host": "broker:7490"}, {"Host": "Broker."},
                         {"Host": "LocalHost:1"}):
                self.assertEqual(ask(port, "GET", target, headers=good)[0], 200, (target, good))
            for bad in ({"X-Forwarded-For": "127.0.0.1"}, {"Forwarded": "for=127.0.0.1"}, {"X-Real-IP": "127.0.0.1"}, {"Via": "1.1 a"},
                        {"X-Forwarded-Host": "localhost"}, {"x-forwarded-port": "7490"}, {"X-Forwarded-Proto": "http"}, {"Host": "evil.example"}, {"Host": "localhost.evil.example"},
                        {"Host": "127.0.0.1.evil.example:7490"}):
                self.assertEqual(ask(port, "GET", target, headers=bad)[0], 401, (target, bad))

    def test_a_request_names_one_host(self):
        data, admin = self.start()
        for port, target in ((data, "/v1/streams"), (admin, "/metrics"), (data, "/v1/nothing")):
            def status(version, *fields):
                with socket.create_connection(("127.0.0.1", port), timeout=60) as sock:
                    sock.sendall("\r\n".join((f"GET {target} HTTP/{version}", *fields, "", "")).encode() * 2)
                    answers = b"".join(iter(lambda: sock.recv(65536), b""))
                return [int(code) for code in re.findall(rb"^HTTP/1.1 (\d+)", answers, re.MULTILINE)]
            good = 404 if target == "/v1/nothing" else 200
            self.assertEqual(status("1.0"), [good])
            self.assertEqual(status("1.1", "Host: localhost", "Connection: close"), [good])
            for bad in ([], ["Host: localhost", "host: localhost"], ["Host: 127.0.0.1%x.evil"], ["Host: [::1%1]"], ["Host: [::1].evil"],
                        ["Host: localhost:x"], ["Host: a b"], ["Host: a/b"], ["Host: user@localhost"]):
                self.assertEqual(status("1.1", *bad), [400], bad)

    def test_an_upgrade_has_no_body(self):
        data, _ = self.start()
        for field in ("Content-Length: 5", "Transfer-Encoding: chunked"):
            peer = Peer(data, "/v1/subscribe", "eigencast.v2", [field])
            self.assertEqual(peer.status, 400)
            self.assertIn("Connection: close", peer.head)
            peer.sock.close()

    def test_a_reload_that_comes_too_late_ends_nothing(self):
        for _ in range(3):
            broker = Broker(BROKER)
            broker.process.send_signal(signal.SIGTERM)
            while broker.process.poll() is None:
                broker.process.send_signal(signal.SIGHUP)
                time.sleep(0.0002)
            shutil.rmtree(broker.folder)
            self.assertEqual(broker.process.returncode, 0)

    def test_a_reload_that_comes_before_the_start_ends_is_ignored(self):
        folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        os.mkfifo(folder / "config")
        broker = subprocess.Popen([BROKER, f"--config={folder}/config", "--listen=127.0.0.1:0", f"--data-dir={folder}", f"--port-file={folder}/port"],
                                  stderr=subprocess.DEVNULL)
        self.addCleanup(broker.wait)
        self.addCleanup(broker.kill)
        with open(folder / "config", "w"):  # As soon as the broker reads it, until it has.
            broker.send_signal(signal.SIGHUP)
        while not (folder / "port").exists() and broker.poll() is None:
            time.sleep(0.01)
        broker.send_signal(signal.SIGTERM)
        self.assertEqual(broker.wait(60), 0)

    def start_with_asset(self, *flags):
        data, admin = self.start(f"--access-jwt-secret={SECRET}", *flags)
        body, name = payloads.asset()
        self.assertIn(ask(data, "PUT", f"/v1/assets/{name}", body)[0], (200, 201))
        return data, admin

    def test_invented_names_refuse_no_sender(self):
        for threads in (1, 2):
            data, _ = self.start_with_asset(f"--threads={threads}")
            strangers = [connect(data, "/v1/subscribe") for _ in range(16)]
            refused = 0
            for i, stranger in enumerate(strangers):
                for j in range(64):
                    order(stranger, "subscribe", stream=f"invented/{i}/{j}")
            for stranger in strangers:
                refused += sum(hear(stranger, "stream", "error")["op"] == "error" for _ in range(64))
            sender, answer = announce(data, "real", "camera")
            self.assertEqual(answer["op"], "announced", answer)
            self.assertEqual(refused, 16 * 64 - 256, "per_address.waiting_streams")
            crowd = [connect(data, "/v1/subscribe/real") for _ in range(100)]
            self.assertEqual({hear(viewer, "stream", "error")["state"] for viewer in crowd}, {"live"}, "100 viewers of the same address")
            waiting = connect(data, "/v1/subscribe/soon", "viewer")
            self.assertEqual(hear(waiting, "stream", "error").get("state"), "waiting", "a token has a quota of its own")
            order(strangers[0], "unsubscribe", stream="invented/0/0")
            answer = {}
            while answer.get("op") != "stream":  # What is given back can be taken again, once all loops know.
                order(strangers[0], "subscribe", stream="again")
                answer = hear(strangers[0], "stream", "error")
                self.assertNotEqual(answer["op"], "closed")
            sender.sock.close()

    def test_one_address_or_token_leaves_places_to_others(self):
        data, admin = self.start(f"--access-jwt-secret={SECRET}", "--access-anonymous=nowhere", "--limits-max-connections=200",
                                 "--limits-max-subscribers-per-stream=40")
        auth = {"Authorization": f"Bearer {token('camera')}"}
        body, name = payloads.asset()
        self.assertEqual(ask(data, "PUT", f"/v1/assets/{name}", body, headers=auth)[0], 201)
        silent = {socket.create_connection(("127.0.0.1", data), timeout=60) for _ in range(210)}
        for one in silent:
            self.addCleanup(one.close)
        refused = set()
        while len(refused) < 170:
            ready = select.select(silent - refused, [], [], 60)[0]
            self.assertTrue(ready, "those beyond its share are closed at once")
            for one in ready:
                self.assertIn(b" 429 ", one.recv(4096))
                refused.add(one)
        self.assertEqual(ask(data, "GET", "/v1/streams", source="127.0.0.2", headers=auth)[0], 200)
        self.assertEqual(ask(admin, "GET", "/readyz")[2], "ready\n")
        for one in silent:
            one.close()
        while json.loads(ask(admin, "GET", "/api/broker")[2])["connections"] > 0:
            time.sleep(0.01)  # Until the broker has noticed.
        sender, answer = announce(data, "show", "camera")
        self.addCleanup(sender.sock.close)
        self.assertEqual(answer["op"], "announced", answer)
        crowd = [connect(data, "/v1/subscribe/show", "crowd") for _ in range(30)]
        self.assertEqual([hear(viewer, "stream", "error")["op"] for viewer in crowd], 8 * ["stream"] + 22 * ["error"])
        self.assertEqual(hear(connect(data, "/v1/subscribe/show", "guest"), "stream", "error")["op"], "stream")

    def test_a_full_broker_says_so(self):
        data, admin = self.start("--limits-max-connections=32")
        held = []
        while True:
            held.append(socket.create_connection(("127.0.0.1", data), timeout=60))
            self.addCleanup(held[-1].close)
            held[-1].sendall(b"GET /v1/streams HTTP/1.1\r\nHost: localhost\r\n\r\n")
            if b" 200 " not in held[-1].recv(4096):
                break
        self.assertEqual(len(held), 31, "this machine leaves a sixteenth")
        self.assertIn("30 of 32 connections", ask(admin, "GET", "/readyz")[2])

    def hoard(self, port, count):
        """Senders that begin large messages and do not end them: the codes with which some are closed."""
        codes = []
        for i in range(count):
            peer = connect(port, f"/v1/publish/hoard/{i}")
            self.addCleanup(peer.sock.close)
            peer.send(frame(BINARY, bytes(300_000), fin=False), frame(PING))
            while (heard := peer.receive())[0] not in (PONG, CLOSE):
                pass
            if heard[0] == CLOSE:
                codes.append(int.from_bytes(heard[1][:2], "big"))
            else:
                self.held.append(peer)
        return codes

    def test_unfinished_messages_are_limited_in_bytes(self):
        for limit in ("per-address-unfinished-bytes=1000000", "limits-max-unfinished-bytes=4000000"):
            self.held = []
            data, _ = self.start_with_asset(f"--{limit}")
            codes = self.hoard(data, 10)
            self.assertIn(len(self.held), (1, 2, 3), limit)
            self.assertEqual(set(codes), {1013})
            sender, answer = announce(data, "real", "camera")
            self.assertEqual(answer["op"], "announced", "others go on")
            order(sender, "ping", id=1, time_us=2)
            self.assertEqual(hear(sender, "pong")["id"], 1)
            for peer in self.held:
                peer.sock.close()
            while 1013 in self.hoard(data, 1):
                time.sleep(0.05)  # Until the broker has noticed.

    def test_messages_that_trickle_are_ended(self):
        data, _ = self.start("--timeouts-idle-ms=1000")
        for path in ("/v1/publish/a", "/v1/subscribe"):
            for piece in (b"x", frame(0, b"", fin=False), frame(PING) + frame(0, b"x", fin=False)):
                peer, ended = connect(data, path), threading.Event()
                peer.send(frame(BINARY, bytes(50_000))[:20_000] if piece == b"x" else frame(BINARY, bytes(20_000), fin=False))

                def trickle():
                    with contextlib.suppress(OSError):
                        while not ended.wait(0.05):
                            peer.send(piece)

                trickling = threading.Thread(target=trickle)
                trickling.start()
                try:
                    while (heard := peer.receive())[0] != CLOSE:
                        pass
                    self.assertEqual(int.from_bytes(heard[1][:2], "big"), 1013, piece)
                finally:
                    ended.set()
                    trickling.join()
                    peer.sock.close()

    def test_answers_that_are_not_read_are_limited_in_bytes(self):
        data, admin = self.start_with_asset("--per-address-unfinished-bytes=200000", "--sockets-send-buffer-bytes=4608")
        sender, answer = announce(data, "show", "camera")
        self.addCleanup(sender.sock.close)
        self.assertEqual(answer["op"], "announced", answer)
        asks = [frame(TEXT, json.dumps({"op": "subscribe", "stream": "show", "profile": {"rate": "raw", "bands": 1 + i % 2}}).encode()) for i in range(100)]
        viewers = []
        for _ in range(16):
            viewers.append(Peer(data, "/v1/subscribe", "eigencast.v2", receive_buffer=2048))
            self.addCleanup(viewers[-1].sock.close)
            viewers[-1].send(*asks)
        while (left := sum(client["kind"] == "viewer" for client in json.loads(ask(admin, "GET", "/api/clients")[2])["clients"])) > 8:
            for viewer in viewers:
                with contextlib.suppress(OSError):
                    viewer.send(frame(PONG))
            time.sleep(0.1)
        self.assertGreater(left, 0, "those that fit stay")
        reader = connect(data, "/v1/subscribe/show")
        self.assertEqual(hear(reader, "stream", "error")["op"], "stream", "who reads is served")

    def test_frames_that_are_not_read_are_limited_in_bytes(self):
        data, admin = self.start_with_asset("--per-address-unfinished-bytes=2000000", "--sockets-send-buffer-bytes=4608")
        sender, answer = self.announce_large(data, "show", "camera", "float64")
        self.assertEqual(answer["op"], "announced", answer)
        values = struct.pack("<32768d", *(32768 * [1.25]))
        key = bytes([len(values) & 127 | 128, len(values) >> 7 & 127 | 128, len(values) >> 14]) + values
        self.assertEqual(len(values), 1 << 18)
        join = bytes([0, 0, 0, 1]) + bytes([128, 128, 32]) + 2 * values
        sender.send(frame(BINARY, payloads.Chain().write(payloads.JOIN, 1, 0, 1, answer["tag"]) + join))
        count = lambda: sum(client["kind"] == "viewer" for client in json.loads(ask(admin, "GET", "/api/clients")[2])["clients"])
        for _ in range(16):
            viewer = Peer(data, "/v1/subscribe/show?rate=raw", "eigencast.v2", receive_buffer=2048)
            self.addCleanup(viewer.sock.close)
        self.assertEqual(count(), 16)
        while count() > 4:
            time.sleep(0.1)
        self.assertGreater(count(), 0, "those that fit stay")
        reader = connect(data, "/v1/subscribe/show?rate=raw", "guest")
        while (heard := reader.receive())[0] != BINARY:
            pass
        self.assertEqual(heard[1][payloads.Chain().read(heard[1]).size:], join, "who reads is served")

    def test_memory_of_streams_is_limited_in_bytes(self):
        data, _ = self.start(f"--access-jwt-secret={SECRET}", "--access-anonymous=nowhere", "--limits-max-stream-bytes=30000000")
        body, name = payloads.asset()
        self.assertEqual(ask(data, "PUT", f"/v1/assets/{name}", body, headers={"Authorization": f"Bearer {token('camera')}"})[0], 201)
        answers = [self.announce_large(data, f"large/{i}", "greedy")[1] for i in range(10)]
        announced = sum(answer["op"] == "announced" for answer in answers)
        self.assertIn(announced, (2, 3), "2.75 MB each, of a fifth of 30 MB")
        self.assertEqual({answer.get("code") for answer in answers[announced:]}, {"too-large"})
        self.assertEqual(announce(data, "small", "greedy")[1]["op"], "announced")
        self.assertEqual(self.announce_large(data, "other", "camera")[1]["op"], "announced", "others go on")

        def served(subject, rate, k):
            viewer = connect(data, f"/v1/subscribe/other?rate={rate}&k={k}", subject)
            self.addCleanup(viewer.sock.close)
            profile = hear(viewer, "stream")["profile"]
            return (profile["rate"], profile.get("k"))

        asked = [(rate, k) for rate in ("interpolated", "estimated") for k in range(2, 16)]
        got = [served("greedy", *profile) for profile in asked]
        exactly = sum(profile == wanted for profile, wanted in zip(got, asked))
        self.assertIn(exactly, range(12, 17), "about 0.4 MB each, of a fifth of 30 MB")
        self.assertEqual(got[:exactly], asked[:exactly])
        self.assertIn(got[-1], [*asked[:exactly], ("raw", None)], "the nearest that is served")
        self.assertEqual(served("guest", "estimated", 15), ("estimated", 15), "others get theirs")

    def test_unfinished_heads_are_limited_in_bytes(self):
        data, _ = self.start("--per-address-unfinished-bytes=65536")
        large = b"GET /v1/streams HTTP/1.1\r\nHost: localhost\r\nX-Large: " + bytes(8192 * b"x")
        peers = [Peer(data, upgrade=False) for _ in range(4)]
        for peer in peers:
            self.addCleanup(peer.sock.close)
            peer.send(large)
        waiting = list(peers)
        while len(waiting) > 1:
            for peer in select.select([peer.sock for peer in waiting], [], [], 60)[0]:
                waiting = [other for other in waiting if other.sock is not peer]
                self.assertIn(b" 429 ", peer.recv(4096).split(b"\r\n")[0])
        self.assertEqual(ask(data, "GET", "/v1/streams")[0], 200, "an ordinary head")
        waiting[0].send(b"\r\n\r\n")
        self.assertIn(b" 200 ", waiting[0].sock.recv(4096))

    def count_of(self, admin, name):
        return int(float(re.search(rf"^eigencast_broker_{name}_total (\S+)", ask(admin, "GET", "/metrics")[2], re.MULTILINE)[1]))

    def announce_large(self, port, name, subject, codec="quantised"):
        """A sender of 32,768 coefficients, and what its announcement was answered."""
        sender = connect(port, f"/v1/publish/{name}", subject)
        self.addCleanup(sender.sock.close)
        announced = {"asset": payloads.asset()[1], "key_rate_hz": 50,
                     "format": {"rows": 4096, "channels": 8, "band_ends": [4096], "codec": codec}}
        order(sender, "announce", **announced)
        return sender, hear(sender, "announced", "error")

    def large_stream(self, port, name, subject):
        """A sender of 32,768 coefficients, and keys of 9 bytes that change none of them."""
        sender, answer = self.announce_large(port, name, subject)
        self.assertEqual(answer["op"], "announced", answer)
        chain = payloads.Chain()
        pose = lambda kind, i: chain.write(kind, 1, i, 1_000_000 + i, answer["tag"])
        sender.send(frame(BINARY, pose(payloads.JOIN, 0) + bytes([2, 160, 160, 1, 2, 0x9F, 0x9F])))
        return sender, b"".join(frame(BINARY, pose(payloads.KEY, 1 + i) + bytes([3, 1, 0xBF])) for i in range(1500))

    def flood(self, peer, data):
        """Sends what the connection takes at once; then another holder is answered, often enough that all could be read."""
        self.addCleanup(peer.sock.close)
        peer.sock.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            peer.sock.send(data)
        for i in range(50):
            order(self.other, "ping", id=i, time_us=2)
            self.assertEqual(hear(self.other, "pong")["id"], i, "others go on")
        peer.sock.close()

    def test_keys_are_paced_by_what_they_make_the_broker_decode(self):
        data, admin = self.start_with_asset("--per-token-work-us-per-s=10000")
        self.other = connect(data, "/v1/subscribe", "other")
        for i in range(3):
            self.flood(*self.large_stream(data, f"large/{i}", "greedy"))
        taken = self.count_of(admin, "frames_received")
        self.assertGreater(taken, 0)
        self.assertLess(taken, 2000, "of 4,500, by one token over three connections")

    def viewed_stream(self, work_us_per_s):
        """What sends one more key, what connects a viewer, and what viewers have lost, by a name of theirs."""
        data, _ = self.start(f"--access-jwt-secret={SECRET}", "--access-anonymous=nowhere",
                             f"--per-token-work-us-per-s={work_us_per_s}")
        body, asset = payloads.asset()
        bearer = {"Authorization": f"Bearer {token('camera')}"}
        self.assertEqual(ask(data, "PUT", f"/v1/assets/{asset}", body, headers=bearer)[0], 201)
        sender = connect(data, "/v1/publish/a", "camera")
        self.addCleanup(sender.sock.close)
        order(sender, "announce", asset=asset, key_rate_hz=50,
              format={"rows": 16, "channels": 3, "band_ends": [16], "codec": "quantised"})
        chain, tag, lost = payloads.Chain(), hear(sender, "announced")["tag"], collections.Counter()
        pose = lambda kind, i: frame(BINARY, chain.write(kind, 1, i, 1_000_000 + 1000 * i, tag) + body_of[kind])
        body_of = {payloads.JOIN: bytes([2, 160, 160, 1, 2, 0x9F, 0x9F]), payloads.KEY: bytes([3, 1, 0xBF])}

        def read(viewer, name):
            with contextlib.suppress(EOFError, OSError):
                while True:
                    opcode, payload = viewer.receive()
                    if opcode == TEXT:
                        lost[name] += json.loads(payload).get("frames_dropped", 0)

        def view(who, name, reads=True):
            viewer = connect(data, "/v1/subscribe/a?rate=raw", who)
            self.addCleanup(viewer.sock.close)
            hear(viewer, "stream")
            if reads:
                threading.Thread(target=read, args=(viewer, name), daemon=True).start()
            return viewer

        numbers = itertools.count(1)
        sender.send(pose(payloads.JOIN, 0))
        return lambda: sender.send(pose(payloads.KEY, next(numbers))), view, lost

    def test_deliveries_are_paced_by_their_number(self):
        send, view, lost = self.viewed_stream(8000)
        for name in 40 * ["greedy"] + ["other"]:
            view(name, name)
        for _ in range(30_000):
            send()
            if lost["greedy"] > 0:
                break
            time.sleep(0.001)
        self.assertGreater(lost["greedy"], 0, "20,000 of 4 us a second, ten times what one may")
        self.assertEqual(lost["other"], 0)

    def test_viewers_that_leave_have_paid_for_what_they_got(self):
        send, view, lost = self.viewed_stream(1000)
        viewers = [view("greedy", "gone", reads=False) for _ in range(60)]
        for _ in range(30):
            send()
            while viewers[-1].receive()[0] != BINARY:
                pass
        for viewer in viewers:
            viewer.sock.close()
        view("greedy", "next")  # It watches 200 a second, of 4 us each; what those before got takes 7 s of its budget.
        for _ in range(2000):
            send()
            if lost["next"] > 0:
                break
            time.sleep(0.005)
        self.assertGreater(lost["next"], 0)

    def test_control_messages_are_paced_by_their_bytes(self):
        data, admin = self.start_with_asset("--per-token-work-us-per-s=1000")
        self.other = connect(data, "/v1/subscribe", "other")
        message = {"op": "pong", "id": 1, "time_us": 1, "peer_time_us": 1, "x": 20_000 * [[]]}
        text = json.dumps(message, separators=(",", ":")).encode()
        for i in range(10):
            self.flood(connect(data, f"/v1/publish/{i}", "greedy"), 3 * frame(TEXT, text))
        self.assertLess(self.count_of(admin, "control_received") - 10 * 50, 15, "of 30 large ones")

    def test_fragments_are_paced_by_their_number(self):
        data, admin = self.start_with_asset("--per-token-work-us-per-s=1000", "--limits-control-messages-per-s=100000")
        self.other = connect(data, "/v1/subscribe", "other")
        empty = frame(0, fin=False)
        question = json.dumps({"op": "ping", "id": 1, "time_us": 2}).encode()
        self.flood(connect(data, "/v1/publish/a", "greedy"), frame(TEXT, question, fin=False) + 30_000 * empty + frame(0))
        self.assertEqual(self.count_of(admin, "control_received"), 50, "only the other's")

    def test_changes_of_profile_are_paced_by_what_they_encode(self):
        data, admin = self.start_with_asset("--per-token-work-us-per-s=1000")
        self.other, _ = self.large_stream(data, "large", "sender")
        changes = b"".join(frame(TEXT, json.dumps({"op": "subscribe", "stream": "large", "profile": {"rate": "interpolated", "k": 2 + i % 14}}).encode())
                           for i in range(90))
        for _ in range(3):
            self.flood(connect(data, "/v1/subscribe", "greedy"), changes)
        self.assertLess(self.count_of(admin, "joins_sent"), 135, "of 270")

    def test_chunks_of_an_upload_are_paced_by_their_number(self):
        data, _ = self.start("--per-address-work-us-per-s=1000", "--timeouts-shutdown-ms=100")
        with socket.create_connection(("127.0.0.1", data), timeout=5) as upload:
            upload.sendall(f"PUT {asset_of(b'')} HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n".encode())
            with self.assertRaises(TimeoutError, msg="6 s for each 65,536 chunks"):
                upload.sendall(2_000_000 * b"1\r\nx\r\n")
        self.assertEqual(ask(data, "GET", "/v1/streams", source="127.0.0.2")[0], 200, "others go on")

    def test_pings_are_paced_by_what_their_answers_cost(self):
        data, _ = self.start("--per-address-work-us-per-s=1000", "--limits-control-messages-per-s=100000")
        peer = connect(data, "/v1/subscribe")
        with takes_at_least(self, 1.5, "600 of 4 us"):
            for i in range(600):
                order(peer, "ping", id=i, time_us=1)
            for i in range(600):
                self.assertEqual(hear(peer, "pong")["id"], i)

    def test_announcements_are_paced_by_the_viewers_who_are_told(self):
        data, _ = self.start_with_asset("--per-token-work-us-per-s=1000")
        sender, _ = announce(data, "a", "camera")
        self.viewers = [connect(data, "/v1/subscribe/a") for _ in range(30)]
        for viewer in self.viewers:
            hear(viewer, "stream")
        with takes_at_least(self, 2, "10 of 100 us, and 10 us a viewer"):
            for _ in range(10):
                sender.send(frame(TEXT, payloads.announce(payloads.asset()[1], 4, "float32").encode()))
                self.assertEqual(hear(sender, "announced", "error")["op"], "announced")

    def test_flapping_senders_evict_their_own_poses(self):
        data, _ = self.start_with_asset("--limits-max-streams=8")
        flap(data, ["kept"], "camera")
        flap(data, [f"flap/{i}" for i in range(20)], "other")
        flap(data, [f"flap/anonymous/{i}" for i in range(20)])
        self.assertEqual(state_of(data, "kept"), "stalled")
        self.assertEqual(announce(data, "kept", "camera")[1]["op"], "announced")

    def test_streams_left_with_viewers_are_limited_by_holder(self):
        data, _ = self.start_with_asset("--limits-max-streams=8", "--per-token-sent-streams=4")
        viewer = connect(data, "/v1/subscribe")
        answers = []
        for i in range(8):
            sender, answer = announce(data, f"left/{i}", "other")
            order(viewer, "subscribe", stream=f"left/{i}")
            while hear(viewer, "stream")["stream"] != f"left/{i}":
                pass  # An earlier one stalled.
            sender.sock.close()
            answers.append(answer["op"])
        self.assertEqual(announce(data, "real", "camera")[1]["op"], "announced")
        self.assertEqual(answers, 4 * ["announced"] + 4 * ["error"])

    def test_a_trace_does_not_grow_beyond_what_viewers_take(self):
        data, _ = self.start_with_asset()
        sender, _ = announce(data, "real", "camera")
        viewer = connect(data, "/v1/subscribe/real?rate=raw")
        hear(viewer, "stream")
        order(viewer, "trace_request", stream="real", every=1)
        hear(sender, "trace_request")

        def trace(sequence, last=""):
            stages = [{"stage": "x" * 4000 * bool(last), "time_us": 1}] * 16 + [{"stage": last, "time_us": 1}]
            return json.dumps({"op": "trace", "stream_id": 0, "sequence": sequence, "stages": stages}, separators=(",", ":")).encode()
        longest = trace(1, "y" * (65536 - len(trace(1, "y")) + 1))
        self.assertEqual(len(longest), 65536)
        sender.send(frame(TEXT, longest), frame(TEXT, trace(2)))
        self.assertEqual(hear(viewer, "trace")["sequence"], 2, "the broker's stream id and epoch would make the first longer")

    def test_download_bytes_per_address_are_limited(self):
        body, name = payloads.asset()
        asset = f"/v1/assets/{name}"
        port, admin = self.start(f"--per-address-download-bytes-per-hour={3 * len(body)}", "--per-address-upload-bytes-per-hour=1000000")
        self.assertIn(ask(port, "PUT", asset, body)[0], (200, 201))
        for _ in range(3):
            self.assertEqual(ask(port, "GET", asset)[::2], (200, body if isinstance(body, str) else body.decode()))
        status, headers, text = ask(port, "GET", asset)
        self.assertEqual(status, 429)
        self.assertGreater(int(headers["Retry-After"]), 0)
        self.assertIn("per_address.download_bytes_per_hour", text)
        self.assertEqual(ask(port, "HEAD", asset)[0], 200, "a head has no bytes")
        self.assertEqual(ask(port, "GET", asset, source="127.0.0.2")[0], 200, "another address")
        self.assertIn(f"eigencast_broker_download_bytes_total {4 * len(body)}", ask(admin, "GET", "/metrics")[2])


class Logs(unittest.TestCase):
    """What strangers can do to a log."""

    def setUp(self):
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="eigencast-doors-"))
        self.addCleanup(shutil.rmtree, self.folder)

    def announce(self, port, assets):
        """One connection announces surfaces that are not here, each of another name. How many were refused before it was."""
        peer, refused = Peer(port, "/v1/publish/a", "eigencast.v2"), 0
        try:
            for asset in assets:
                peer.send(frame(TEXT, payloads.announce(asset, 3, "float32").encode()))
                while json.loads(peer.receive()[1])["op"] != "error":
                    pass
                refused += 1
        except (OSError, ValueError, EOFError):
            pass  # It was closed.
        return refused

    def test_a_flood_of_one_kind_is_counted_and_does_not_fill_the_log(self):
        lines = 20
        names = ["".join(random.choices("abcdef", k=64)) for _ in range(2000)]
        with open(self.folder / "log", "wb") as log:
            with Broker(BROKER, "--log-level=info", f"--log-max-lines={lines}", "--limits-control-messages-per-s=1000000", stderr=log) as broker:
                begun = time.monotonic()
                refused = self.announce(broker.port, names)
                periods = 2 + (time.monotonic() - begun) // 10
        text = (self.folder / "log").read_text().splitlines()
        counts = [int(found[1]) for line in text if (found := re.search(r" (\d+) more lines like this: .*announcement refused", line))]
        written = [line for line in text if "announcement refused" in line and " more lines like this: " not in line]
        self.assertLessEqual(len(written), lines * periods)
        self.assertGreaterEqual(len(counts), 1)
        self.assertLessEqual(len(counts), periods)
        self.assertGreater(refused, lines * periods, "a flood")
        self.assertEqual(len(written) + sum(counts), refused, "each is written or counted")
        self.assertTrue(any("listening on port" in line for line in text))

    def test_a_log_that_nobody_takes_stops_no_one(self):
        for read in (False, True):
            from_broker, to_log = os.pipe()
            os.set_blocking(to_log, False)
            filled = 0
            try:
                while True:
                    filled += os.write(to_log, b"x" * 4096)
            except BlockingIOError:
                os.set_blocking(to_log, True)
            with Broker(BROKER, "--log-level=info", stderr=to_log) as broker:
                os.close(to_log)
                self.announce(broker.port, ["0" * 64] * 20)
                self.assertEqual(ask(broker.port, "GET", "/v1/streams")[0], 200)
                taken = []
                if read:
                    reader = threading.Thread(target=lambda: taken.append(open(from_broker, "rb", closefd=False).read()))
                    reader.start()
            if read:
                reader.join()
                self.assertIn(b"announcement refused", taken[0][filled:])
                self.assertIn(b"listening on port", taken[0][filled:])
            os.close(from_broker)

    def test_control_characters_of_strangers_reach_no_terminal(self):
        hostile = (b"a\x1b[31m", b"a\x9b31m", "a\u009b31m".encode(), "a\u202e".encode(), b"a\x7f")
        for style in ("text", "json"):
            with open(self.folder / style, "wb") as log:
                with Broker(BROKER, "--log-level=info", f"--log-format={style}", "--access-anonymous=loopback", stderr=log) as broker:
                    for host in hostile:
                        with socket.create_connection(("127.0.0.1", broker.port)) as sock:
                            sock.sendall(b"GET /v1/streams HTTP/1.1\r\nHost: " + host + b"\r\n\r\n")
                            sock.recv(65536)
            log = (self.folder / style).read_bytes()
            self.assertIn(b"Host header", log)
            self.assertIn(b"\\u009b31m", log)
            self.assertNotRegex(log, b"[\x00-\x09\x0b-\x1f\x7f\x80-\x9f]", style)
            self.assertNotIn("\u202e".encode(), log)
            for line in log.splitlines() if style == "json" else ():
                json.loads(line)


class Files(unittest.TestCase):
    """What lies on disk, and the keys of TLS."""

    def setUp(self):
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="eigencast-doors-"))
        self.addCleanup(shutil.rmtree, self.folder)

    def secret(self, name, text, mode):
        (self.folder / name).write_text(text)
        (self.folder / name).chmod(mode)
        return self.folder / name

    def certificate(self, kind):
        if not shutil.which("openssl"):
            self.skipTest("no openssl")
        subprocess.run(["openssl", "req", "-x509", "-newkey", kind, "-nodes", "-days", "30", "-subj", "/CN=localhost",
                        "-keyout", self.folder / "tls.key", "-out", self.folder / "tls.pem"], check=True, stderr=subprocess.DEVNULL)
        return self.folder / "tls.pem", self.folder / "tls.key"

    def check(self, *flags):
        return subprocess.run([BROKER, "--check-config", *flags], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def test_secrets_that_others_can_read_are_warned_about(self):
        certificate, key = self.certificate("rsa:2048")
        long_secret = "a secret of the tests, of more than 32 bytes"
        token = subprocess.run([BROKER, "token", "create", "--static", "--subject=a", "--admin"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.secret("tokens", token.stderr.splitlines()[-1] + "\n", 0o600)
        self.secret("hs256", long_secret, 0o600)
        public = subprocess.run(["openssl", "pkey", "-in", key, "-pubout"], check=True, stdout=subprocess.PIPE, text=True).stdout
        self.secret("public", public, 0o644)
        self.secret("nats.creds", "creds", 0o600)
        self.secret("nats.key", key.read_text(), 0o600)
        key.chmod(0o640)
        config = self.secret("eigencast.toml", f"""
            [access]
            jwt_secret = "{long_secret}"
            jwt_keys = ["a HS256 {self.folder}/hs256", "b RS256 {self.folder}/public"]
            tokens_file = "{self.folder}/tokens"
            [tls]
            certificate = "{certificate}"
            key = "{key}"
            [backbone]
            servers = ["nats://127.0.0.1:1"]
            credentials = "{self.folder}/nats.creds"
            certificate = "{certificate}"
            key = "{self.folder}/nats.key"
            """, 0o600)
        self.assertEqual([self.check(f"--config={config}").returncode, self.check(f"--config={config}").stderr], [0, ""])
        for name in ("eigencast.toml", "hs256", "tokens", "tls.key", "nats.creds", "nats.key"):
            usual = (self.folder / name).stat().st_mode
            (self.folder / name).chmod(0o644)
            checked = self.check(f"--config={config}")
            self.assertEqual(checked.returncode, 0, (name, checked.stderr))
            self.assertIn(f"{self.folder}/{name}: ", checked.stderr)
            self.assertEqual(len(checked.stderr.splitlines()), 1, checked.stderr)
            (self.folder / name).chmod(usual)
        (self.folder / "tokens").chmod(0o644)
        with open(self.folder / "log", "wb") as log:  # At the start, and by a reload.
            with Broker(BROKER, f"--access-tokens-file={self.folder}/tokens", "--log-level=warning", stderr=log) as broker:
                (self.folder / "hs256").chmod(0o644)
                self.assertEqual(ask(broker.port, "GET", "/v1/streams", headers={"Authorization": "Bearer " + token.stdout.strip()})[0], 200)
        self.assertIn(f"{self.folder}/tokens: ", (self.folder / "log").read_text())
        plain = self.secret("plain.toml", "[server]\nthreads = 1\n", 0o644)
        self.assertEqual(self.check(f"--config={plain}").stderr, "", "no secret")

    def test_files_of_a_broker_started_by_hand_are_private(self):
        body, name = payloads.asset()
        usual = os.umask(0o022)
        self.addCleanup(os.umask, usual)
        for mask, private in ((0o022, 0o077), (0o027, 0o027)):
            os.umask(mask)
            folder = self.folder / f"data{mask}"
            with Broker(BROKER, f"--data-dir={folder}", "--recording-streams=**") as broker:
                self.assertIn(ask(broker.port, "PUT", f"/v1/assets/{name}", body)[0], (200, 201))
                self.assertEqual((pathlib.Path(broker.folder) / "port").stat().st_mode & 0o777, 0o666 & ~mask, "others read the port")
                found = [folder, *folder.rglob("*")]
                self.assertTrue(any(path.is_file() for path in found))
                for path in found:
                    self.assertEqual(path.stat().st_mode & private, 0, path)

    def test_handshakes_of_an_address_are_paced(self):
        certificate, key = self.certificate("rsa:2048")
        context = tls_client()
        hello = client_hello(context)
        with Broker(BROKER, f"--tls-certificate={certificate}", f"--tls-key={key}", "--per-address-work-us-per-s=1000",
                    "--timeouts-header-ms=1000") as broker:
            copies = [socket.create_connection(("127.0.0.1", broker.port), timeout=60) for _ in range(100)]
            answered = 0
            for copy in copies:
                with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                    copy.sendall(hello)
                    answered += copy.recv(1) != b""
                copy.close()
            self.assertGreater(answered, 0)
            self.assertLess(answered, 50, "five a second")
            with socket.create_connection(("127.0.0.1", broker.port), timeout=60, source_address=("127.0.0.2", 0)) as other:
                context.wrap_socket(other).close()

    def test_handshakes_wait_for_memory(self):
        certificate, key = self.certificate("rsa:2048")
        context = tls_client()
        with Broker(BROKER, f"--tls-certificate={certificate}", f"--tls-key={key}", "--per-address-unfinished-bytes=200000",
                    "--timeouts-header-ms=60000") as broker:

            def enter():
                with socket.create_connection(("127.0.0.1", broker.port), timeout=60) as sock:
                    context.wrap_socket(sock).close()

            with socket.create_connection(("127.0.0.1", broker.port), timeout=60) as first:
                first.sendall(client_hello(context))
                self.assertEqual(first.recv(1), bytes([22]), "it has what one may have")
                entering = [threading.Thread(target=enter, daemon=True) for _ in range(8)]
                for thread in entering:
                    thread.start()
                entering[0].join(0.3)
                self.assertTrue(all(thread.is_alive() for thread in entering))
            for thread in entering:
                thread.join(60)
                self.assertFalse(thread.is_alive())

    def test_a_hello_in_many_records_ends_the_connection(self):
        certificate, key = self.certificate("rsa:2048")
        hello = client_hello(tls_client())[5:]
        with Broker(BROKER, f"--tls-certificate={certificate}", f"--tls-key={key}") as broker:
            for size, good in ((100, True), (1, False)):
                with socket.create_connection(("127.0.0.1", broker.port), timeout=60) as sock:
                    pieces = [hello[i:i + size] for i in range(0, len(hello), size)]
                    answer = b""
                    with contextlib.suppress(ConnectionError):
                        sock.sendall(b"".join(struct.pack(">BHH", 22, 0x301, len(piece)) + piece for piece in pieces))
                        answer = sock.recv(1)
                    self.assertEqual(answer == bytes([22]), good, f"{len(pieces)} records")

    def test_long_lists_in_a_hello_end_the_connection(self):
        """OpenSSL keeps them, at up to 50 times their bytes, as long as the connection."""
        certificate, key = self.certificate("rsa:2048")
        hello = client_hello(tls_client())[5:]
        at = 4 + 2 + 32
        at += 1 + hello[at]
        ciphers = hello[at + 2:at + 2 + int.from_bytes(hello[at:at + 2], "big")]
        begin, extensions = hello[4:at], hello[at + 2 + len(ciphers) + 2 + 2:]
        sized = lambda data: struct.pack(">H", len(data)) + data
        extension = lambda kind, data: struct.pack(">H", kind) + sized(data)
        names = lambda size: extension(47, sized(size // 4 * (sized(b"\x30\0"))))
        responders = lambda size: extension(5, b"\1" + sized(size // 6 * sized(b"\xa2\2\4\0")) + sized(b""))
        with Broker(BROKER, f"--tls-certificate={certificate}", f"--tls-key={key}") as broker:
            for more_ciphers, more, good in ((b"", names(400), True), (b"", names(60_000), False), (b"", names(2_000), False),
                                             (b"", responders(400), True), (b"", responders(2_000), False),
                                             (400 * b"\x13", b"", True), (2_000 * b"\x13", b"", False),
                                             (b"", extension(0xFE0D, bytes(3_000)), True)):
                body = begin + sized(ciphers + more_ciphers) + b"\1\0" + sized(more + extensions)
                message = b"\1" + len(body).to_bytes(3, "big") + body
                records = b"".join(b"\x16\3\1" + sized(message[i:i + 16_000]) for i in range(0, len(message), 16_000))
                with socket.create_connection(("127.0.0.1", broker.port), timeout=60) as sock:
                    sock.sendall(records)
                    self.assertEqual(sock.recv(1), bytes([22 if good else 21]), f"{len(more_ciphers)} and {len(more)} bytes more")

    def test_certificates_of_clients_are_few_and_paced_where_they_are_wrong(self):
        """Their keys are decoded before they are checked, at up to 1.2 us a byte."""
        certificate, key = self.certificate("rsa:2048")
        text, other = certificate.read_text(), self.folder / "many.pem"
        with Broker(BROKER, f"--tls-certificate={certificate}", f"--tls-key={key}", f"--tls-client-ca={certificate}",
                    "--per-address-work-us-per-s=10000", "--timeouts-header-ms=60000") as broker:

            def enter(chain):
                context = tls_client()
                other.write_text(chain)
                context.load_cert_chain(other, key)
                with socket.create_connection(("127.0.0.1", broker.port), timeout=60) as sock, context.wrap_socket(sock) as tls:
                    tls.sendall(b"GET /v1/streams HTTP/1.1\r\nHost: localhost\r\n\r\n")
                    return tls.recv(100)

            self.assertIn(b" 200 ", enter(4 * text))
            with self.assertRaises((ssl.SSLError, OSError)):
                enter(40 * text)
            foreign, _ = self.certificate("rsa:2048")
            with takes_at_least(self, 3, "what each wrong one costs"):
                for _ in range(3):
                    with self.assertRaises((ssl.SSLError, OSError)):
                        enter(foreign.read_text())

    def test_records_of_one_byte_are_paced_by_their_number(self):
        certificate, key = self.certificate("rsa:2048")
        context = tls_client()
        with Broker(BROKER, f"--tls-certificate={certificate}", f"--tls-key={key}", "--per-address-work-us-per-s=1000") as broker:
            with socket.create_connection(("127.0.0.1", broker.port), timeout=60) as sock, context.wrap_socket(sock) as tls:
                with takes_at_least(self, 1, "100 reads of 3 us, pauses of 20 us"):
                    for byte in b"GET /v1/streams HTTP/1.1\r\nHost: localhost\r\nX: " + 50 * b"x" + b"\r\n\r\n":
                        tls.send(bytes([byte]))
                    self.assertIn(b" 200 ", tls.recv(100))

    def test_handshakes_cost_what_their_key_takes(self):
        certificate, key = self.certificate("rsa:3072")
        context = tls_client()
        with Broker(BROKER, f"--tls-certificate={certificate}", f"--tls-key={key}", "--per-address-work-us-per-s=1000") as broker:
            with takes_at_least(self, 2, "two before the third, each 1.5 ms or more"):
                for _ in range(3):
                    with socket.create_connection(("127.0.0.1", broker.port), timeout=60) as sock:
                        context.wrap_socket(sock).close()

    def test_renewed_keys_end_a_connection(self):
        certificate, key = self.certificate("rsa:2048")
        with Broker(BROKER, f"--tls-certificate={certificate}", f"--tls-key={key}") as broker:
            client = subprocess.Popen(["openssl", "s_client", "-connect", f"127.0.0.1:{broker.port}", "-tls1_3"],
                                      stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            self.addCleanup(client.kill)
            for sent in itertools.count():
                if client.poll() is not None or sent == 2000:
                    break
                with contextlib.suppress(BrokenPipeError):
                    client.stdin.write(b"k\n")  # Makes s_client renew its keys.
                    client.stdin.flush()
                time.sleep(0.01)
            self.assertTrue(20 < sent < 2000, sent)
            with contextlib.suppress(BrokenPipeError):
                client.communicate()

    def test_dear_groups_are_refused(self):
        certificate, key = self.certificate("rsa:2048")
        with Broker(BROKER, f"--tls-certificate={certificate}", f"--tls-key={key}") as broker:
            for group, good in (("prime256v1", True), ("secp384r1", False), ("secp521r1", False)):
                context = tls_client()
                context.set_ecdh_curve(group)
                with socket.create_connection(("127.0.0.1", broker.port), timeout=60) as sock:
                    with contextlib.nullcontext() if good else self.assertRaises((ssl.SSLError, OSError), msg=group):
                        context.wrap_socket(sock).close()

    def test_tls_without_forward_secrecy_is_refused(self):
        certificate, key = self.certificate("rsa:2048")  # With an elliptic curve nothing else could be.
        with Broker(BROKER, f"--tls-certificate={certificate}", f"--tls-key={key}") as broker:
            def handshake(ciphers):
                context = tls_client()
                context.maximum_version = ssl.TLSVersion.TLSv1_2
                context.set_ciphers(ciphers)
                with socket.create_connection(("127.0.0.1", broker.port)) as sock, context.wrap_socket(sock) as tls:
                    return tls.cipher()[0]

            for weak in ("kRSA:@SECLEVEL=0", "AES128-GCM-SHA256", "kDHE+SHA1:@SECLEVEL=0", "ECDHE+SHA1:@SECLEVEL=0", "aNULL:@SECLEVEL=0"):
                with self.assertRaises((ssl.SSLError, OSError), msg=weak):
                    handshake(weak)
            for good in ("ECDHE+AESGCM", "ECDHE+CHACHA20"):
                self.assertTrue(handshake(good).startswith("ECDHE-RSA-"), good)


class Inherited(unittest.TestCase):
    """Sockets that systemd hands over."""

    def start(self, names, *sockets):
        folder = self.enterContext(tempfile.TemporaryDirectory())
        hand_over = "import os, sys; os.environ.update(LISTEN_PID=str(os.getpid())); os.execv(sys.argv[1], sys.argv[1:])"
        command = [sys.executable, "-c", hand_over, BROKER, "--admin-listen=127.0.0.1:0", f"--data-dir={folder}"]
        places = range(3, 3 + len(sockets))
        high = [fcntl.fcntl(one, fcntl.F_DUPFD, 20) for one in sockets]

        def place():
            for fd, to in zip(high, places):
                os.dup2(fd, to)
        broker = subprocess.Popen(command, preexec_fn=place, pass_fds=places, stderr=subprocess.PIPE, text=True,
                                  env=dict(os.environ, LISTEN_FDS=str(len(sockets)), LISTEN_FDNAMES=":".join(names)))
        for fd in high:
            os.close(fd)
        self.addCleanup(broker.communicate)
        self.addCleanup(broker.terminate)
        return broker

    def listening(self, family=socket.AF_INET, address=("127.0.0.1", 0), protocol=0):
        try:
            one = socket.socket(family, socket.SOCK_STREAM, protocol)
        except OSError:
            return None  # This kernel has no such protocol.
        self.addCleanup(one.close)
        one.bind(address)
        one.listen()
        return one

    def test_only_tcp_is_taken(self):
        tcp = self.listening()
        self.start(["data"], tcp)
        self.assertEqual(ask(tcp.getsockname()[1], "GET", "/v1/streams")[0], 200)
        strange = [self.listening(socket.AF_UNIX, "\0eigencast-" + os.urandom(8).hex()), self.listening(protocol=262),
                   self.listening(protocol=132)]  # MPTCP and SCTP.
        for one in filter(None, strange):
            for names, sockets in ((["data"], [one]), (["data", "admin"], [self.listening(), one])):
                broker = self.start(names, *sockets)
                self.assertEqual(broker.wait(60), 2, (names, one))

    def test_a_name_is_given_once(self):
        broker = self.start(["data", "data"], self.listening(), self.listening())
        self.assertEqual(broker.wait(60), 2)


class Monitors(unittest.TestCase):
    start = HttpAccess.start

    def test_monitors_read_the_admin_port_and_change_nothing(self):
        own = own_address()
        if not own:
            self.skipTest("this machine has no address but loopback, whence everybody may read")
        secret = "--access-jwt-secret=a secret of the tests, of more than 32 bytes"
        for monitors, status in (("198.51.100.7/32", 401), (f"{own}/32", 200)):
            _, admin = self.start(secret, "--admin-listen=0.0.0.0:0", f"--access-monitors={monitors}")
            for target in ("/metrics", "/api/clients", "/"):
                self.assertEqual(ask(admin, "GET", target, host=own)[0], status, target)
            for order in ("/api/drain", "/api/clients/kick?id=1", "/api/recordings/start?stream=s"):
                self.assertEqual(ask(admin, "POST", order, host=own)[0], 401, order)
            self.assertEqual(ask(admin, "GET", "/readyz", host=own)[0], 200, "it was not drained, and everybody may ask that")


if __name__ == "__main__":
    BROKER = sys.argv.pop(1)
    cases.main()
