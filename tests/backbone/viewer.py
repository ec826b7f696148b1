# SPDX-License-Identifier: MIT
"""A viewer of one stream that connects again for ever, and notes what a viewer must never see."""
import contextlib
import json
import threading
import time

import payloads
from websocket_peer import BINARY, TEXT, Peer


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
                    peer = Peer(self.ports[turn % len(self.ports)], f"/v1/subscribe/{self.stream}" + "?rate=raw" * self.raw, "eigencast.v2")
                peer.sock.settimeout(0.5)
                self.watch(peer)
            except (OSError, EOFError, AssertionError):
                turn += 1
                time.sleep(0.02)

    def watch(self, peer):
        said, chain = None, payloads.Chain()
        while not self.over:
            try:
                opcode, payload = peer.receive()
            except TimeoutError:
                continue
            message = json.loads(payload) if opcode == TEXT else {}
            if message.get("op") == "stream":
                said = message["stream_id"], message.get("tag"), message["epoch"]
                if message["stream"] != self.stream:
                    self.faults.append(f"told of {message['stream']}")
                if not self.raw:
                    self.newest = None
            if opcode == BINARY:
                self.take(chain.read(payload), said)

    def take(self, head, said):
        if not head or not said or (head.stream_id, head.tag) != said[:2] or said[2] < self.epoch:
            self.faults.append(f"{head} within {said}; seen: {self.epoch}")
            return
        # No step is the key itself, after what leads up to it.
        at, epoch = (head.sequence, head.at / head.of if head.of else 1), said[2]
        if epoch == self.epoch and self.newest:
            skips = self.raw and head.kind == payloads.KEY and head.sequence != self.newest[0] + 1
            if at < self.newest or skips:
                self.faults.append(f"{at} after {self.newest}")
        self.newest, self.epoch = at, epoch
        self.frames += 1
