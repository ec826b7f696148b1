# SPDX-License-Identifier: MIT
"""100 streams of r = 200 at 30 keys a second, each watched interpolated x3 by one viewer: the broker's share of one core."""
import math
import random
import socket
import time

import payloads
from harness import Server

STREAMS, ROWS, RATE, SECONDS = 100, 200, 30, 6
BANDS = [14, 54, 104, 200]


def connect(port, path, hello, ready):
    sock = socket.create_connection(("127.0.0.1", port))
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.sendall((f"GET {path} HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
                  "Sec-WebSocket-Key: x3JJHMbDL1EzLkh9GBhXDw==\r\nSec-WebSocket-Protocol: eigencast.v1\r\n\r\n").encode())
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


def motion(keys):
    """Keys of a plausible motion: large slow coefficients below, small ones above; as values of each band."""
    source = random.Random(1)
    parts = [(2000 / (1 + k) ** 0.8, source.uniform(0, 6.28), source.uniform(1, 6)) for k in range(ROWS * 3)]
    for i in range(keys):
        t = i / RATE
        q = [round(size * math.sin(phase + speed * t) + source.gauss(0, 1)) for size, phase, speed in parts]
        begin = 0
        bands = []
        for end in BANDS:
            bands.append(q[begin * 3:end * 3])
            begin = end
        yield bands


def run(tools):
    with Server(tools, "broker") as server:
        senders, viewers = [], []
        hello = payloads.announce(tools.asset, ROWS, "quantised", BANDS)
        for i in range(STREAMS):
            senders.append(connect(server.port, f"/v1/publish/s{i}", hello, b'"announced"'))
            viewers.append(connect(server.port, f"/v1/subscribe/s{i}", None, b""))
            viewers[-1].setblocking(False)
        keys = list(motion(RATE * (SECONDS + 1)))
        period = 1 / RATE
        start = time.monotonic() + 0.1
        received = spent = 0
        for i, bands in enumerate(keys):
            due = start + i * period
            frame = payloads.quantised_frame(payloads.KEY if i else payloads.JOIN, i, int(i * period * 1e6) + 1, len(BANDS), bands)
            wire = framed(0x82, frame)
            if i == RATE:
                spent = server.cpu_seconds()
            for j in range(STREAMS):
                wait = due + period * j / STREAMS - time.monotonic()
                if wait > 0:
                    time.sleep(wait)
                senders[j].sendall(wire)
                try:
                    received += len(viewers[j].recv(1 << 18))
                except BlockingIOError:
                    pass
        spent = server.cpu_seconds() - spent
        took = time.monotonic() - start - 1
        print(f"  {STREAMS} streams, r = {ROWS}, {RATE} keys/s of {len(wire)} bytes, x3: {100 * spent / took:.1f} % of one core; "
              f"{received / took / 1e6:.1f} MB/s to viewers")
