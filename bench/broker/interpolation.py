# SPDX-License-Identifier: MIT
"""100 streams of r = 200 at 30 keys a second, as a sender codes them: the broker's share of one core where each is watched
interpolated x3 by one viewer, beside raw by three, which makes as many deliveries a second of the same keys. What
interpolation alone costs, without a socket, says interpolation_rate."""
import os
import pathlib
import socket
import subprocess
import sys
import time

import payloads
from harness import Server

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "tests/support"))
from websocket_peer import BINARY, Peer

STREAMS, ROWS, RATE, SECONDS = 100, 200, 30, 4
BANDS = [14, 54, 104, 200]


def connect(port, path, hello, ready):
    sock = socket.create_connection(("127.0.0.1", port))
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.sendall((f"GET {path} HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
                  "Sec-WebSocket-Key: x3JJHMbDL1EzLkh9GBhXDw==\r\nSec-WebSocket-Protocol: eigencast.v2\r\n\r\n").encode())
    read_until(sock, b"\r\n\r\n")
    if hello:
        sock.sendall(framed(0x81, hello.encode()))
        read_until(sock, ready)
    return sock


def read_until(sock, needle):
    seen = b""
    while needle not in seen:
        piece = sock.recv(65536)
        if not piece:
            raise ConnectionError(f"closed before {needle}: {seen[:300]}")
        seen += piece


def framed(first, payload):
    """A client's frame with the mask of zeros."""
    size = len(payload)
    head = bytes([first, 0x80 | size]) if size < 126 else bytes([first, 0xFE]) + size.to_bytes(2, "big")
    return head + bytes(4) + payload


def real_keys(tools, count):
    """A join and keys as a sender codes them, of the gallop of EIGENCAST_DATA_DIR or else of the heart: their bytes; taken
    once from a broker and kept."""
    clip = pathlib.Path(os.environ.get("EIGENCAST_DATA_DIR", ""), "animations/horse-gallop/vertices.npy")
    what = clip if clip.exists() else "heart"
    file = tools.folder / f"{'horse' if clip.exists() else 'heart'}.frames"
    if not file.exists():
        sender = tools.broker.parent / "eigencast-sender"
        with Server(tools, "broker") as server:
            play = subprocess.Popen([sender, "play", "--wait", what, "--to", f"ws://127.0.0.1:{server.port}/motion", "--rate", str(RATE)],
                                    stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            viewer = Peer(server.port, "/v1/subscribe/motion?rate=raw", "eigencast.v2")
            viewer.sock.settimeout(60)
            frames = []
            while len(frames) < count:
                opcode, message = viewer.receive()[:2]
                if opcode == BINARY:
                    frames.append(message)
            play.terminate()
            play.wait()
        file.write_bytes(b"".join(len(frame).to_bytes(4, "little") + frame for frame in frames))
    data, frames = file.read_bytes(), []
    while data:
        size = int.from_bytes(data[:4], "little")
        frames.append(data[4:4 + size])
        data = data[4 + size:]
    return frames[:count]


def run(tools, repeat):
    keys = real_keys(tools, RATE * (SECONDS + 1))
    print(f"  {STREAMS} streams, r = {ROWS}, {RATE} keys/s of {sum(map(len, keys)) / len(keys):.0f} bytes: % of one core")
    settings = [("x3, one viewer each", "", 1), ("raw, three viewers each", "?rate=raw", 3), ("raw, one viewer each", "?rate=raw", 1)]
    seen = {name: [] for name, _, _ in settings}
    for _ in range(repeat):
        for name, query, viewers in settings:
            seen[name].append(share_of_core(tools, keys, query, viewers))
    for name, runs in seen.items():
        print(f"  {name:24}" + "".join(f"{100 * share:7.1f}" for share, _ in runs) + f"; {runs[0][1]:.0f} kB/s to viewers", flush=True)


def share_of_core(tools, keys, query, viewers_each):
    """The broker's CPU seconds a second, and what the viewers were sent, while all streams are sent and watched."""
    with Server(tools, "broker", frames_ladder="false") as server:
        hello = payloads.announce(tools.asset, ROWS, "quantised", BANDS)
        senders = [connect(server.port, f"/v1/publish/s{i}", hello, b'"announced"') for i in range(STREAMS)]
        viewers = [[connect(server.port, f"/v1/subscribe/s{i}{query}", None, b"") for _ in range(viewers_each)] for i in range(STREAMS)]
        for viewer in sum(viewers, []):
            viewer.setblocking(False)
        period = 1 / RATE
        start = time.monotonic() + 0.1
        received = spent = 0
        for i, frame in enumerate(keys):
            wire = framed(0x82, frame)
            if i == RATE:
                spent, received = server.cpu_seconds(), 0
            for j in range(STREAMS):
                wait = start + i * period + period * j / STREAMS - time.monotonic()
                if wait > 0:
                    time.sleep(wait)
                senders[j].sendall(wire)
                received += sum(map(drained, viewers[j]))
        took = time.monotonic() - start - 1
        return (server.cpu_seconds() - spent) / took, received / took / 1e3


def drained(viewer):
    try:
        return len(viewer.recv(1 << 18))
    except BlockingIOError:
        return 0
