#!/usr/bin/python3
# SPDX-License-Identifier: MIT
"""Figure 9 and Equation 8: bytes on the wire by clients, objects and rate, counted by clients of a real broker.

    figure9.py BIN_FOLDER OUT_FOLDER [--plot-only]

Starts a broker and senders of float64 coefficients (r = 200) on loopback, watches them raw over plain WebSockets, and counts
every byte after the handshake. Writes figure9.csv and, where matplotlib is installed (python3-matplotlib), figure9.png.

Equation 8 of Zhang, Dou, Zhou, Wu 2013 as printed is |C| * 8 bytes * sum of objects x rate; the paper's own 1,152 kbit/s
need a factor 3 for x, y, z.
"""
import base64
import csv
import os
import pathlib
import selectors
import socket
import struct
import subprocess
import sys
import tempfile
import time

RANK = 200
SECONDS = 3
CASES = [(1, 1, 30), (2, 1, 30), (4, 1, 30), (8, 1, 30), (1, 2, 30), (1, 4, 30), (1, 1, 10), (1, 1, 60), (4, 4, 10)]


class Viewer:
    """One WebSocket that counts the bytes and the whole frames of what it is sent, between two times."""

    def __init__(self, port, stream):
        self.socket = socket.create_connection(("127.0.0.1", port))
        key = base64.b64encode(os.urandom(16)).decode()
        self.socket.sendall(
            f"GET /v1/subscribe/{stream}?rate=raw HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: eigencast.v1\r\n\r\n".encode()
        )
        self.buffer = b""
        while b"\r\n\r\n" not in self.buffer:
            self.buffer += self.socket.recv(65536)
        head, self.buffer = self.buffer.split(b"\r\n\r\n", 1)
        if b" 101 " not in head.split(b"\r\n", 1)[0]:
            raise RuntimeError("the broker said " + head.decode(errors="replace"))
        self.socket.setblocking(False)
        self.bytes = self.frames = 0

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
            if self.buffer[0] & 15 == 2 and self.buffer[at] & 7 == 1:  # A key.
                self.bytes += at + size
                self.frames += 1
            self.buffer = self.buffer[at + size :]


def start_broker(folder, data):
    port_file = data / "port"
    broker = subprocess.Popen(
        [folder / "eigencast-broker", "--listen", "127.0.0.1:0", "--admin-listen", "", "--data-dir", data / "broker", "--port-file", port_file,
         "--log-level", "error"])
    for _ in range(100):
        time.sleep(0.1)
        if port_file.exists() and port_file.read_text().strip():
            return broker, int(port_file.read_text())
    broker.terminate()
    raise RuntimeError("the broker did not start")


def watch(port, clients, objects):
    viewers = [Viewer(port, f"object{o}") for o in range(objects) for _ in range(clients)]
    selector = selectors.DefaultSelector()
    for viewer in viewers:
        selector.register(viewer.socket, selectors.EVENT_READ, viewer)
    begin = time.monotonic() + 1
    started = False
    while (now := time.monotonic()) < begin + SECONDS:
        if not started and now >= begin:
            started = True
            for viewer in viewers:
                viewer.bytes = viewer.frames = 0
        for event, _ in selector.select(0.05):
            event.data.read()
    for viewer in viewers:
        viewer.socket.close()
    return sum(v.bytes for v in viewers) / SECONDS, sum(v.frames for v in viewers) / len(viewers) / SECONDS


def measure(folder, clients, objects, rate, port, data):
    senders = [
        subprocess.Popen(
            [folder / "eigencast-sender", "--no-progress", "play", "heart", "--codec", "float64", "--rank", str(RANK), "--rate", str(rate),
             "--cache", str(data / "cache"), "--to", f"ws://127.0.0.1:{port}/object{o}"], stderr=subprocess.DEVNULL)
        for o in range(objects)
    ]
    try:
        time.sleep(2)
        counted, frames = watch(port, clients, objects)
    finally:
        for sender in senders:
            sender.terminate()
            sender.wait()
    printed = RANK * 8 * objects * clients * rate
    return {"clients": clients, "objects": objects, "rate": rate, "keys_per_s": round(frames, 2), "eq8_printed_kbit": printed * 8e-3,
            "eq8_times_3_kbit": 3 * printed * 8e-3, "counted_kbit": round(counted * 8e-3, 1),
            "counted_over_eq8_times_3": round(counted / (3 * printed * frames / rate), 4)}


def plot(rows, path):
    try:
        import matplotlib
    except ImportError:
        print("SKIPPED: no python3-matplotlib, so no picture", file=sys.stderr)
        return
    matplotlib.use("Agg")
    from matplotlib import pyplot

    number = lambda row, name: float(row[name])
    labels = [f"{r['clients']} x {r['objects']} x {r['rate']}/s" for r in rows]
    figure, axes = pyplot.subplots(figsize=(9, 5))
    places = range(len(rows))
    for shift, name, label in [(-0.27, "eq8_printed_kbit", "Eq. 8 as printed"), (0, "eq8_times_3_kbit", "Eq. 8, times 3 for x, y, z"),
                               (0.27, "counted_kbit", "counted by the clients, headers and all")]:
        axes.bar([p + shift for p in places], [number(r, name) / 1000 for r in rows], 0.26, label=label)
    axes.set_xticks(list(places), labels, rotation=30, ha="right")
    axes.set_ylabel("Mbit/s out of the broker")
    axes.set_xlabel("clients x objects x poses")
    axes.set_title(f"float64 coefficients, r = {RANK}, raw")
    axes.legend()
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main(arguments):
    folder, out = pathlib.Path(arguments[0]), pathlib.Path(arguments[1])
    out.mkdir(parents=True, exist_ok=True)
    table = out / "figure9.csv"
    if "--plot-only" not in arguments:
        with tempfile.TemporaryDirectory() as name:
            data = pathlib.Path(name)
            subprocess.run([folder / "eigencast-sender", "--no-progress", "bake", "heart", "--rank", str(RANK), "--cache", str(data / "cache")],
                           check=True, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
            broker, port = start_broker(folder, data)
            try:
                rows = [measure(folder, *case, port, data) for case in CASES]
            finally:
                broker.terminate()
                broker.wait()
        with open(table, "w", newline="") as file:
            writer = csv.DictWriter(file, rows[0].keys())
            writer.writeheader()
            writer.writerows(rows)
    with open(table) as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        print(row)
    plot(rows, out / "figure9.png")
    worst = max(abs(float(row["counted_over_eq8_times_3"]) - 1) for row in rows)
    print(f"Eq. 8 with factor 3 and the bytes counted differ by at most {100 * worst:.2f} %")
    return 0 if worst <= 0.02 else 1


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    sys.exit(main(sys.argv[1:]))
