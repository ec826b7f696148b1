#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""What strangers may take and see, asked from outside by HTTP: the limit of downloads, who reads the admin port; how it ends.

    http_access_test.py BROKER [-v]
"""
import http.client
import pathlib
import shutil
import signal
import socket
import sys
import time
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/support"), str(ROOT / "bench/broker")]
import cases
import payloads
from websocket_peer import Broker, ports_of

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


class HttpAccess(unittest.TestCase):
    def start(self, *flags):
        broker = Broker(BROKER, *flags)
        self.addCleanup(broker.__exit__)
        return ports_of(pathlib.Path(broker.folder) / "port")

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

    def test_a_reload_that_comes_too_late_ends_nothing(self):
        for _ in range(3):
            broker = Broker(BROKER)
            broker.process.send_signal(signal.SIGTERM)
            while broker.process.poll() is None:
                broker.process.send_signal(signal.SIGHUP)
                time.sleep(0.0002)
            shutil.rmtree(broker.folder)
            self.assertEqual(broker.process.returncode, 0)

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
