# SPDX-License-Identifier: MIT
"""A viewer of one stream that connects again for ever, and notes what a viewer must never see."""
import contextlib
import json
import struct
import threading
import time

from websocket_peer import BINARY, TEXT, Peer

KEY = 1


class Viewer(threading.Thread):
    """Watches at one of several brokers, at the next when that is gone; keys only if `raw`. `within`: the network that it is on."""

    def __init__(self, ports, stream="s", raw=False, within=contextlib.nullcontext):
        super().__init__(daemon=True)
        self.ports, self.stream, self.raw, self.within = ports, stream, raw, within
        self.epoch = self.frames = 0
        self.newest, self.faults, self.over = None, [], False
        self.start()

    def run(self):
        turn = 0
        while not self.over:
            try:
                with self.within():
                    peer = Peer(self.ports[turn % len(self.ports)], f"/v1/subscribe/{self.stream}" + "?rate=raw" * self.raw, "eigencast.v1")
                peer.sock.settimeout(0.5)
                self.watch(peer)
            except (OSError, EOFError, AssertionError):
                turn += 1
                time.sleep(0.02)

    def watch(self, peer):
        said = None
        while not self.over:
            try:
                opcode, payload = peer.receive()
            except TimeoutError:
                continue
            message = json.loads(payload) if opcode == TEXT else {}
            if message.get("op") == "stream":
                said = message["stream_id"], message["epoch"]
                if message["stream"] != self.stream:
                    self.faults.append(f"told of {message['stream']}")
                if not self.raw:
                    self.newest = None
            if opcode == BINARY:
                self.take(payload, said)

    def take(self, payload, said):
        first, _, step, of, epoch, sequence, _ = struct.unpack("<BBBIIQQ", payload[:27])
        # A step of 0 is the key itself, after what leads up to it.
        at = sequence, (step >> 4) / (step & 15) if step else 1
        if (of, epoch) != said or epoch < self.epoch:
            self.faults.append(f"a frame of stream and epoch {(of, epoch)} within {said}; seen: {self.epoch}")
        if epoch == self.epoch and self.newest:
            skips = self.raw and first & 7 == KEY and sequence != self.newest[0] + 1
            if at < self.newest or skips:
                self.faults.append(f"{at} after {self.newest}")
        self.newest, self.epoch = at, epoch
        self.frames += 1
