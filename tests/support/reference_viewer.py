# SPDX-License-Identifier: MIT
"""A viewer of raw keys that holds what its stream remembers, decoded by tools/reference_decoder.py alone."""
import contextlib
import json
import pathlib
import socket
import sys
import threading
import time
import typing
import urllib.request

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "bench/broker")]
import payloads
from reference_memory import Memory
from websocket_peer import BINARY, TEXT, Peer, frame

ACK_S = 0.05


class Pose(typing.NamedTuple):
    epoch: int
    sequence: int
    capture_us: int
    recalled: bool
    values: list


class Epoch(typing.NamedTuple):
    """Of one connection: the `stream` message that began it, and what followed: frames, and (kept, segments) of memories."""
    stream: dict
    came: list

    def frames(self):
        return [one for one in self.came if isinstance(one, bytes)]

    def poses(self):
        """Those of its frames. Raises on what breaks the protocol, on what it refers to and does not hold, and on a frame before its join."""
        receiver, poses = Memory(self.stream["format"], bytes.fromhex(self.stream["asset"])), []
        for one in self.came:
            if not isinstance(one, bytes):
                kept, segments = one
                del receiver.segments[kept:]
                for segment in segments:
                    receiver.add_segment(segment)
                continue
            decoded = receiver.decode(one)
            if decoded is None or decoded["tag"] != self.stream["tag"]:
                raise AssertionError(f"epoch {self.stream['epoch']}: {decoded} has to wait for a join")
            key = decoded.get("pose") or decoded["newer"]
            step = 2 ** (key["step"] % 4 / 4) * 2.0 ** (key["step"] // 4 - 40)
            poses.append(Pose(self.stream["epoch"], decoded["sequence"], decoded["capture_us"], decoded["flags"] >= 4, [q * step for q in key["values"]]))
        return poses


class ReferenceViewer(threading.Thread):
    """Connects again for ever, until end(). `prepares`: says that it holds an asset that comes next, without a look at it."""

    def __init__(self, port, stream, prepares=True):
        super().__init__(daemon=True)
        self.port, self.stream, self.prepares = port, stream, prepares
        self.epochs, self.memories, self.recalled, self.over = [], 0, 0, threading.Event()
        self.next_asset = self.peer = None
        self.start()

    def end(self):
        self.over.set()
        while self.is_alive():  # It may be connecting.
            with contextlib.suppress(OSError, AttributeError):
                self.peer.sock.shutdown(socket.SHUT_RDWR)
            self.join(0.1)

    def run(self):
        while not self.over.is_set():
            try:
                self.peer = Peer(self.port, f"/v1/subscribe/{self.stream}?rate=raw", "eigencast.v2")
                self.watch(self.peer)
            except (OSError, EOFError, AssertionError):
                self.over.wait(0.05)

    def watch(self, peer):
        chain, generation, acked_s, epoch = payloads.Chain(), 0, 0.0, None
        say = lambda **message: peer.send(frame(TEXT, json.dumps(message).encode()))
        while not self.over.is_set():
            opcode, payload = peer.receive()
            message = json.loads(payload) if opcode == TEXT else {}
            if message.get("op") == "stream":
                if message["state"] != "waiting" and (epoch is None or message["epoch"] != epoch.stream["epoch"]):
                    epoch, generation = Epoch(message, []), 0
                    self.epochs.append(epoch)
                self.next_asset = (message.get("next") or {}).get("asset")
                if self.next_asset and self.prepares:
                    say(op="prepared", stream=self.stream, asset=self.next_asset)
            if message.get("op") == "remember":
                epoch.came.append((message.get("kept", 0), [self.fetch(segment) for segment in message["segments"]]))
                generation = message["generation"]
                self.memories += 1
            if opcode != BINARY:
                continue
            epoch.came.append(payload)
            self.recalled += payload[0] >> 5 & 1
            head = chain.read(payload)
            if head and time.monotonic() - acked_s >= ACK_S:
                acked_s = time.monotonic()
                say(op="ack", time_us=0, items=[{"stream_id": head.stream_id, "sequence": head.sequence, "step": 0, "generation": generation}])

    def fetch(self, name):
        with urllib.request.urlopen(f"http://127.0.0.1:{self.port}/v1/assets/{name}", timeout=10) as answer:
            return answer.read()
