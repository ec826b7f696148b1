# SPDX-License-Identifier: MIT
"""100 streams of r = 200 at 30 keys a second, each watched interpolated x3 by one viewer: the broker's share of one core."""
import json
import os
import pathlib
import subprocess
import sys
import time

from harness import Server

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "tests/support"))
from websocket_peer import BINARY, TEXT, Peer, frame

STREAMS, RATE, SECONDS = 100, 30, 6


def record(tools):
    """What a real sender sends of a built-in motion: the announcement's format, and so many seconds of frames, as a raw viewer gets them."""
    with Server(tools, "broker") as server:
        home = {**os.environ, "XDG_CACHE_HOME": str(tools.folder)}
        sender = subprocess.Popen([tools.sender, "play", "torus", "--rate", str(RATE), "--to", f"ws://127.0.0.1:{server.port}/live"], env=home,
                                  stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            viewer = Peer(server.port, "/v1/subscribe/live?rate=raw", "eigencast.v1")
            viewer.sock.settimeout(60)  # It bakes first.
            frames, format = [], None
            while len(frames) < RATE * (SECONDS + 1):
                opcode, payload = viewer.receive()
                if opcode == BINARY:
                    frames.append(payload)
                elif opcode == TEXT and json.loads(payload).get("op") == "stream" and json.loads(payload)["state"] == "live":
                    format = json.loads(payload)["format"]
            return format, frames
        finally:
            sender.terminate()
            sender.wait()


def run(tools):
    if not tools.sender.exists():
        print(f"  SKIPPED: no {tools.sender}")
        return
    format, keys = record(tools)
    with Server(tools, "broker") as server:
        senders, viewers = [], []
        hello = json.dumps({"op": "announce", "asset": tools.asset, "key_rate_hz": RATE, "format": format})
        for i in range(STREAMS):
            senders.append(Peer(server.port, f"/v1/publish/s{i}", "eigencast.v1"))
            senders[-1].send(frame(TEXT, hello.encode()))
            while b'"announced"' not in senders[-1].receive()[1]:
                pass
            viewers.append(Peer(server.port, f"/v1/subscribe/s{i}", "eigencast.v1").sock)
            viewers[-1].setblocking(False)
        period = 1 / RATE
        start = time.monotonic() + 0.1
        received = spent = 0
        for i, key in enumerate(keys):
            due = start + i * period
            wire = frame(BINARY, key)
            if i == RATE:
                spent = server.cpu_seconds()
            for j in range(STREAMS):
                wait = due + period * j / STREAMS - time.monotonic()
                if wait > 0:
                    time.sleep(wait)
                senders[j].send(wire)
                try:
                    received += len(viewers[j].recv(1 << 18))
                except BlockingIOError:
                    pass
        spent = server.cpu_seconds() - spent
        took = time.monotonic() - start - 1
        print(f"  {STREAMS} streams, r = {format['rows']}, {RATE} keys/s of {sum(map(len, keys)) / len(keys):.0f} bytes, x3: {100 * spent / took:.1f} % of one core; "
              f"{received / took / 1e6:.1f} MB/s to viewers")
