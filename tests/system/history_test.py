#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""What a broker keeps of a stream outlives kill -9: all that viewers could see again before can be seen again after.

    history_test.py BROKER [-v]
"""
import pathlib
import struct
import sys
import tempfile
import time
import unittest
import urllib.request

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/support"), str(ROOT / "bench/broker")]
import cases
import payloads
from websocket_peer import BINARY, Broker, Peer, TEXT, control, frame, next_control

BROKER = None
SUBPROTOCOL = "eigencast.v2"
KEYS, ENDS = 90, [4, 8]


class Past:
    """A viewer of stream a that seeks."""

    def __init__(self, port):
        self.peer = Peer(port, "/v1/subscribe/a?rate=raw", SUBPROTOCOL)

    def spans(self):
        self.peer.send(control(op="history", stream="a"))
        return next_control(self.peer, "history").get("spans", [])

    def seek(self, at_us):
        """Number and first value of the pose there; nothing: it is of the present, or not there yet."""
        self.peer.send(control(op="seek", stream="a", at_us=at_us, speed=0))
        while True:
            answer = next_control(self.peer, "stream", "history")
            if answer["op"] == "stream" or answer.get("code"):
                break
        if "rewind" not in answer:
            return None
        while True:
            opcode, payload = self.peer.receive()
            if opcode != BINARY or (head := payloads.Chain().read(payload)) is None or head.stream_id != answer["stream_id"]:
                continue
            size, at = payloads.varint_at(payload, head.size + 4)
            return head.sequence, struct.unpack_from("<f", payload, at + size // 2)[0]


class History(unittest.TestCase):
    def start(self, folder):
        return Broker(BROKER, "--history-streams=**", "--threads=2", f"--data-dir={folder}")

    def test_what_was_kept_is_there_after_kill_9(self):
        with tempfile.TemporaryDirectory() as folder:
            broker = self.start(folder)
            body, name = payloads.asset()
            urllib.request.urlopen(urllib.request.Request(f"http://127.0.0.1:{broker.port}/v1/assets/{name}", data=body, method="PUT")).close()
            sender = Peer(broker.port, "/v1/publish/a", SUBPROTOCOL)
            sender.send(frame(TEXT, payloads.announce(name, ENDS[-1], "float32", ENDS, 30).encode()))
            next_control(sender, "announced")
            chain = payloads.Chain()
            for sequence in range(KEYS):
                bands = [[sequence / 100] * (3 * (end - begin)) for begin, end in zip([0, *ENDS], ENDS)]
                kind = payloads.KEY if sequence else payloads.JOIN
                sender.send(frame(BINARY, payloads.float_frame(chain, kind, sequence, 1_000_000 + sequence * 10_000, bands)))
                time.sleep(0.01)
            past = Past(broker.port)
            last = (KEYS - 1, struct.unpack("<f", struct.pack("<f", (KEYS - 1) / 100))[0])
            while past.seek((1 << 62) - 1) != last:  # Until it is in the file.
                time.sleep(0.05)
            before = past.spans()
            broker.process.kill()
            broker.process.wait()

            with self.start(folder) as again:
                past = Past(again.port)
                while not (spans := past.spans()):
                    time.sleep(0.05)
                self.assertEqual([span["from_us"] for span in spans], [span["from_us"] for span in before])
                self.assertEqual(past.seek(spans[-1]["to_us"]), last)
                self.assertEqual(past.seek(spans[0]["from_us"]), (0, 0.0))
                with urllib.request.urlopen(f"http://127.0.0.1:{again.port}/v1/assets/{name}") as answer:
                    self.assertEqual(answer.read(), body)
                past.peer.sock.close()


if __name__ == "__main__":
    BROKER = sys.argv.pop(1)
    cases.main()
