#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Figure 9 and Equation 8 of Zhang et al. 2013: bytes on the wire by clients, objects and rate, counted by clients of a real broker.

Senders of float64 coefficients (r = 200) on loopback, watched raw over plain WebSockets that count every byte of the keys that
were captured in the same three seconds. Equation 8 as printed is |C| * 8 bytes * sum of objects x rate; the paper's own 1,152
kbit/s need a factor 3 for x, y, z. Its rate is that of the poses that were sent, by the senders' own records: a key that does not
arrive is missing from the count. Ends with status 1 if both differ by more than 2 %.
"""
import base64
import os
import selectors
import socket
import struct
import sys
import time

from common import ROOT, Stage, lines_of, parser, plt, write_picture, write_table

sys.path.insert(0, str(ROOT / "bench/broker"))
import payloads

RANK = 200  # The senders' default.
SECONDS = 3
CASES = [(1, 1, 30), (2, 1, 30), (4, 1, 30), (8, 1, 30), (1, 2, 30), (1, 4, 30), (1, 1, 10), (1, 1, 60), (4, 4, 10)]
HEADER = ["clients", "objects", "rate", "sent_per_s", "eq8_printed_kbit", "eq8_times_3_kbit", "counted_kbit", "counted_over_eq8_times_3"]


class Viewer:
    """One WebSocket that counts the bytes of the keys of which `window` holds the capture time."""

    def __init__(self, port, stream, window):
        self.window = window
        self.socket = socket.create_connection(("127.0.0.1", port))
        key = base64.b64encode(os.urandom(16)).decode()
        self.socket.sendall(
            f"GET /v1/subscribe/{stream}?rate=raw HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: eigencast.v2\r\n\r\n".encode()
        )
        self.buffer = b""
        while b"\r\n\r\n" not in self.buffer:
            self.buffer += self.socket.recv(65536)
        head, self.buffer = self.buffer.split(b"\r\n\r\n", 1)
        if b" 101 " not in head.split(b"\r\n", 1)[0]:
            raise RuntimeError("the broker said " + head.decode(errors="replace"))
        self.socket.setblocking(False)
        self.bytes, self.chain = 0, payloads.Chain()

    def read(self):
        chunk = self.socket.recv(1 << 20)
        if not chunk:
            raise RuntimeError("the broker hung up")
        self.buffer += chunk
        while len(self.buffer) >= 2:
            size, at = self.buffer[1] & 127, 2
            if size >= 126:
                wide = {126: (">H", 2), 127: (">Q", 8)}[size]
                if len(self.buffer) < 2 + wide[1]:
                    return
                size, at = struct.unpack(wide[0], self.buffer[2 : 2 + wide[1]])[0], 2 + wide[1]
            if len(self.buffer) < at + size:
                return
            head = self.chain.read(self.buffer[at : at + size]) if self.buffer[0] & 15 == 2 else None
            if head and head.kind == payloads.KEY:  # Which says when it was captured.
                self.bytes += at + size if head.capture_us in self.window else 0
            self.buffer = self.buffer[at + size :]


def count(port, name, clients, objects, window):
    """Bytes a second, of all clients; reads on for a second after the window."""
    viewers = [Viewer(port, f"{name}-{o}", window) for o in range(objects) for _ in range(clients)]
    selector = selectors.DefaultSelector()
    for viewer in viewers:
        selector.register(viewer.socket, selectors.EVENT_READ, viewer)
    while time.monotonic() < window.stop * 1e-6 + 1:
        for event, _ in selector.select(0.05):
            event.data.read()
    for viewer in viewers:
        viewer.socket.close()
    return sum(v.bytes for v in viewers) / SECONDS


def measure(stage, number, clients, objects, rate):
    name = f"case-{number}"
    records = [stage.folder / f"{name}-{o}.jsonl" for o in range(objects)]
    senders = [stage.start("eigencast-sender", "--no-progress", "play", "--wait", "heart", "--codec", "float64", "--rate", rate, "--to",
                           stage.url(f"{name}-{o}"), "--record", record) for o, record in enumerate(records)]
    for o in range(objects):
        stage.wait_live(f"{name}-{o}")
    begin_us = round((time.monotonic() + 1) * 1e6)
    window = range(begin_us, begin_us + SECONDS * 1_000_000)
    counted = count(stage.port, name, clients, objects, window)
    for sender in senders:
        sender.terminate()
        sender.wait(20)
    sent = sum(line["capture_us"] in window and line["status"] == "sent" for record in records for line in lines_of(record)) / SECONDS
    printed = RANK * 8 * clients * sent
    return [clients, objects, rate, round(sent / objects, 2), round(printed * 8e-3, 1), round(3 * printed * 8e-3, 1),
            round(counted * 8e-3, 1), round(counted / (3 * printed), 4)]


def draw(options, rows):
    figure, axes = plt.subplots(figsize=(9, 5))
    for shift, column, label in [(-0.27, 4, "Eq. 8 as printed"), (0, 5, "Eq. 8, times 3 for x, y, z"),
                                 (0.27, 6, "counted by the clients, headers and all")]:
        axes.bar([i + shift for i in range(len(rows))], [row[column] / 1000 for row in rows], 0.26, label=label)
    axes.set_xticks(range(len(rows)), [f"{row[0]} x {row[1]} x {row[2]}/s" for row in rows], rotation=30, ha="right")
    axes.set_ylabel("Mbit/s out of the broker")
    axes.set_xlabel("clients x objects x poses")
    axes.set_title(f"Figure 9: float64 coefficients, r = {RANK}, raw")
    axes.legend()
    write_picture(options, "figure_09", figure)


def main():
    options = parser(__doc__).parse_args()
    with Stage(options) as stage:
        stage.bake("heart")
        rows = [measure(stage, number, *case) for number, case in enumerate(CASES)]
    write_table(options, "figure_09", HEADER, rows)
    draw(options, rows)
    worst = max(abs(row[-1] - 1) for row in rows)
    print(f"Eq. 8 with factor 3 and the bytes counted differ by at most {100 * worst:.2f} %")
    return 0 if worst <= 0.02 else 1


if __name__ == "__main__":
    sys.exit(main())
