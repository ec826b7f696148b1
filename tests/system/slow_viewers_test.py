#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""What the broker does with viewers that take less than they are offered: the window of acknowledgements, the ladder of profiles.

    slow_viewers_test.py BROKER RELAY [-v]        RELAY: eigencast-impaired-relay
"""
import json
import pathlib
import re
import socket
import subprocess
import sys
import threading
import time
import unittest
import urllib.request

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/support"), str(ROOT / "bench/broker")]
import cases
import payloads
from websocket_peer import BINARY, CLOSE, PING, PONG, TEXT, Broker, Peer, frame, port_of, ports_of

BROKER = RELAY = None
SUBPROTOCOL = "eigencast.v2"
PATIENCE_S = 90


def now_us():
    return time.monotonic_ns() // 1000


class Sender(threading.Thread):
    """Publishes float32 keys of `ends` bands at `rate`, stamped evenly by the clock of now_us(), until it is stopped."""

    def __init__(self, port, stream, ends, rate):
        super().__init__()
        self.peer = Peer(port, f"/v1/publish/{stream}", SUBPROTOCOL)
        self.rate, self.stopped = rate, threading.Event()
        body, name = payloads.asset()
        urllib.request.urlopen(urllib.request.Request(f"http://127.0.0.1:{port}/v1/assets/{name}", data=body, method="PUT")).close()
        self.peer.send(frame(TEXT, payloads.announce(name, ends[-1], "float32", ends, rate).encode()))
        while b'"announced"' not in (text := self.peer.receive()[1]):
            pass
        self.tag = json.loads(text)["tag"]
        self.poses = [[[value] * (3 * (end - begin)) for begin, end in zip([0, *ends], ends)] for value in (0.5, 0.75, 0)]
        self.start()

    def run(self):
        start, sequence, chain = time.monotonic(), 0, payloads.Chain()
        while not self.stopped.is_set():
            kind = payloads.KEY if sequence else payloads.JOIN
            # Even times, so that frames have one size: the window that a kernel offers follows sizes that change.
            capture_us = int(start * 1_000_000) + sequence * (1_000_000 // self.rate)
            self.peer.send(frame(BINARY, payloads.float_frame(chain, kind, sequence, capture_us, self.poses[sequence % 3], self.tag)))
            sequence += 1
            time.sleep(max(0, start + sequence / self.rate - time.monotonic()))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stopped.set()
        self.join()
        self.peer.sock.close()


class Viewer:
    """Collects capture times, profiles and notices; acknowledges and answers pings where it is to."""

    def __init__(self, port, stream, query="", acknowledges=False, answers=True, receive_buffer=0):
        self.answers = answers
        self.peer = Peer(port, f"/v1/subscribe/{stream}{query}", SUBPROTOCOL, receive_buffer=receive_buffer)
        self.captures, self.profiles, self.notices, self.newest = [], [], [], None
        self.chain = payloads.Chain()
        if acknowledges:
            threading.Thread(target=self.acknowledge, daemon=True).start()

    def acknowledge(self):
        """The newest frame, 30 times a second, as long as the connection lives."""
        acknowledged = None
        while self.peer.sock.fileno() >= 0:
            if self.newest != acknowledged:
                acknowledged = self.newest
                self.peer.send(frame(TEXT, json.dumps({"op": "ack", "items": [acknowledged], "time_us": now_us()}).encode()))
            time.sleep(1 / 30)

    def step(self):
        opcode, payload = self.peer.receive()
        if opcode == BINARY:
            self.on_frame(payload)
        elif opcode == TEXT:
            message = json.loads(payload)
            if message["op"] == "stream":
                self.profiles.append(message["profile"])
            if message["op"] == "notice":
                self.notices.append(message["message"])
        elif opcode == PING and self.answers:
            self.peer.send(frame(PONG, payload))
        elif opcode == CLOSE:
            raise EOFError("the broker closed")

    def on_frame(self, payload):
        head = self.chain.read(payload)
        if not head.ahead or head.at:
            self.captures.append(head.shown_us)
        self.newest = {"stream_id": head.stream_id, "sequence": head.sequence, "step": head.at << 4 | head.of}

    def read_until(self, condition, pause=0.0):
        end = time.monotonic() + PATIENCE_S
        while not condition():
            if time.monotonic() > end:
                raise AssertionError(f"waited {PATIENCE_S} s in vain; profiles: {self.profiles}; notices: {self.notices}")
            self.step()
            time.sleep(pause)

    def rungs(self):
        return [(p["rate"], p.get("scheme"), p["bands"]) for p in self.profiles]


class SlowViewers(unittest.TestCase):
    def setUp(self):
        self.broker = Broker(BROKER, "--limits-control-messages-per-s=10000000")  # Floods are not paced here.
        self.addCleanup(self.broker.__exit__)
        self.port = self.broker.port

    def steps_counted(self, direction):
        """Steps of all ladders, as the metrics count them."""
        admin = ports_of(pathlib.Path(self.broker.folder) / "port")[1]
        text = urllib.request.urlopen(f"http://127.0.0.1:{admin}/metrics").read().decode()
        return sum(float(count) for labels, count in re.findall(r"^eigencast_broker_ladder_steps_total{(.*)} (.*)$", text, re.M)
                   if f'direction="{direction}"' in labels)

    def stale_after_a_stall(self, seconds, **viewer):
        """Poses of the time of the stall that the viewer is given when it wakes. The stall ends when another viewer has so many
        seconds' worth of poses."""
        stalled, other = Viewer(self.port, "s", "?rate=raw", **viewer), Viewer(self.port, "s", "?rate=raw")
        stalled.read_until(lambda: len(stalled.captures) > self.rate)
        slept = now_us()
        other.read_until(lambda: other.captures and other.captures[-1] > slept + seconds * 1_000_000)
        newest = other.captures[-1]
        stalled.captures.clear()
        try:
            stalled.read_until(lambda: stalled.captures and stalled.captures[-1] >= newest)
        except EOFError:  # A window may stay narrow: a viewer that then answers no ping gets nothing, and is cut off.
            self.assertFalse(stalled.answers)
        self.assertEqual(stalled.captures, sorted(stalled.captures))
        return sum(slept < capture < newest - 100_000 for capture in stalled.captures)

    def test_an_acknowledging_viewer_gets_few_stale_poses(self):
        self.rate = 30
        with Sender(self.port, "s", [48], self.rate):
            self.assertLessEqual(self.stale_after_a_stall(4, acknowledges=True, receive_buffer=32768), 4)

    def test_a_silent_viewer_is_noticed_by_its_window(self):
        self.rate = 90
        with Sender(self.port, "s", [48], self.rate):
            for receive_buffer in (8192, 32768):
                for answers in (True, False):
                    with self.subTest(receive_buffer=receive_buffer, answers=answers):
                        stale = self.stale_after_a_stall(4, answers=answers, receive_buffer=receive_buffer)
                        print(f"{stale} stale poses, receive buffer {receive_buffer}, answers pings: {answers}")
                        self.assertLessEqual(stale, 40)

    def test_unread_answers_stop_the_reading_of_questions(self):
        viewer = Peer(self.port, "/v1/subscribe", SUBPROTOCOL, receive_buffer=8192)
        viewer.sock.settimeout(3)
        question = frame(TEXT, json.dumps({"op": "ping", "id": 1, "time_us": 1}).encode())
        with self.assertRaises(TimeoutError):  # The broker stops reading, long before it would lose patience.
            for _ in range(20_000):
                viewer.sock.sendall(question * 100)
        viewer.sock.settimeout(60)
        answered = 0
        while answered < 1000:  # What it has heard is answered once the viewer reads, and it hears more.
            opcode, payload = viewer.receive()
            self.assertEqual(opcode, TEXT)
            answered += b'"pong"' in payload
        viewer.sock.close()

    def test_the_latest_ping_of_a_flood_is_answered(self):
        viewer = Peer(self.port, "/v1/subscribe", SUBPROTOCOL, receive_buffer=8192)
        last = 200_000
        for first in range(0, last, 1000):
            viewer.send(*(frame(PING, b"%d" % number) for number in range(first + 1, first + 1001)))
        answered = 0
        while answered < last:
            opcode, payload = viewer.receive()
            if opcode == PONG:
                self.assertGreater(int(payload), answered, "in order")
                answered = int(payload)
        viewer.sock.close()

    def test_a_slow_link_gets_a_lower_rung(self):
        port_file = pathlib.Path(self.broker.folder) / "relay-port"
        # With residuals: 5.8 Mbit/s, linear and raw: 2.0, three bands of four: 1.1.
        relay = subprocess.Popen([RELAY, f"--to={self.port}", f"--port-file={port_file}", "--rate-kbit=1500", "--direction=down"])
        self.addCleanup(relay.wait)
        self.addCleanup(relay.terminate)
        with Sender(self.port, "s", [14, 54, 104, 200], 100):
            viewer = Viewer(port_of(port_file), "s", "?scheme=catmull-rom", acknowledges=True)
            viewer.read_until(lambda: viewer.rungs()[-1:] == [("raw", None, 3)])
            self.assertGreaterEqual(len(viewer.notices), 3, "each step is announced")
            self.assertEqual(viewer.rungs()[-4:], [("interpolated", "catmull-rom", 4), ("interpolated", None, 4), ("raw", None, 4), ("raw", None, 3)])
            stepped = len(viewer.captures)
            viewer.read_until(lambda: len(viewer.captures) > stepped + 400)
            self.assertEqual(viewer.rungs()[-1], ("raw", None, 3), "this rung suits the link")
            self.assertEqual(self.steps_counted("down"), 3)
            self.assertEqual(self.steps_counted("up"), 0)

    def test_the_step_is_undone_when_the_link_recovers(self):
        with Sender(self.port, "s", [14, 54, 104, 200], 60):
            viewer = Viewer(self.port, "s", "?scheme=catmull-rom", receive_buffer=8192)
            viewer.read_until(lambda: viewer.rungs()[-1:] == [("interpolated", None, 4)], pause=0.02)
            viewer.read_until(lambda: viewer.rungs()[-1:] == [("interpolated", "catmull-rom", 4)])
            self.assertEqual(viewer.rungs()[-2:], [("interpolated", None, 4), ("interpolated", "catmull-rom", 4)])
            self.assertEqual((self.steps_counted("down"), self.steps_counted("up")), (1, 1))


if __name__ == "__main__":
    BROKER, RELAY = sys.argv.pop(1), sys.argv.pop(1)
    cases.main()
