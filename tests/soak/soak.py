#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Lets viewers come, watch, stall, download and go for minutes while the stream is recorded and its sender is killed again and
again, then asserts that the broker's memory is flat and no descriptor leaks.

Usage: soak.py BIN_DIR [--minutes M] [--viewers N] [--threads T]. Prints one line of JSON; exit status 1 where an assertion fails.
"""
import argparse
import base64
import json
import os
import random
import re
import signal
import socket
import subprocess
import tempfile
import threading
import time
import urllib.request

WARM_SHARE = 0.34


def upgrade(port, path):
    peer = socket.create_connection(("127.0.0.1", port), timeout=10)
    key = base64.b64encode(os.urandom(16)).decode()
    peer.sendall((f"GET {path} HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: {key}\r\n"
                  "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: eigencast.v2\r\n\r\n").encode())
    head = b""
    while b"\r\n\r\n" not in head:
        part = peer.recv(4096)
        if not part:
            raise ConnectionError("closed in the middle of the upgrade")
        head += part
    if b" 101 " not in head.split(b"\r\n")[0]:
        raise ConnectionError(head.decode(errors="replace"))
    return peer


def download(port, objects, dice):
    """One object of the asset; some leave in the middle."""
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/v1/assets/{dice.choice(objects)}", timeout=10) as answer:
        return len(answer.read(4096 if dice.random() < 0.5 else -1))


def viewer(port, objects, stop, counts, seed):
    """One viewer after another: each watches for a while, perhaps stalls, and leaves, politely or not."""
    dice = random.Random(seed)
    profiles = ["", "?rate=raw", "?scheme=catmull-rom", "?rate=5&bands=2"]
    while not stop.is_set():
        try:
            peer = upgrade(port, "/v1/subscribe/soak/torus" + dice.choice(profiles))
            counts["came"] += 1
            if dice.random() < 0.3:
                counts["downloaded"] += 1
                counts["bytes"] += download(port, objects, dice)
            peer.settimeout(0.5)
            ends = time.monotonic() + dice.uniform(0.2, 6)
            while time.monotonic() < ends and not stop.is_set():
                if dice.random() < 0.02:
                    counts["stalled"] += 1
                    stop.wait(dice.uniform(0.5, 4))
                try:
                    got = peer.recv(65536)
                except socket.timeout:
                    continue
                if not got:
                    break
                counts["bytes"] += len(got)
            if dice.random() < 0.3:  # Without a word: a reset.
                peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
            peer.close()
        except OSError as error:
            counts["errors"] += 1
            counts["last_error"] = str(error)
            stop.wait(0.5)


def ask(port, path, data=None):
    with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", data=data, timeout=10) as answer:
        return json.load(answer)


def metrics(port):
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=10) as answer:
        lines = answer.read().decode().splitlines()
    return {name: float(value) for name, value in (line.rsplit(" ", 1) for line in lines if not line.startswith("#"))}


def median(values):
    return sorted(values)[len(values) // 2]


def open_files(process):
    return len(os.listdir(f"/proc/{process}/fd"))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("bin_dir")
    parser.add_argument("--minutes", type=float, default=2)
    parser.add_argument("--viewers", type=int, default=40)
    parser.add_argument("--threads", type=int, default=1, help="event loops of the broker")
    options = parser.parse_args()
    folder = tempfile.mkdtemp(prefix="eigencast-soak-")
    broker = subprocess.Popen([options.bin_dir + "/eigencast-broker", "--listen", "127.0.0.1:0", "--admin-listen", "127.0.0.1:0",
                               "--port-file", folder + "/port", "--data-dir", folder + "/data", "--threads", str(options.threads)],
                              stderr=open(folder + "/broker.log", "w"))
    processes = [broker]
    try:
        for _ in range(200):
            if os.path.exists(folder + "/port"):
                break
            time.sleep(0.05)
        port, admin = (int(line) for line in open(folder + "/port").read().split())

        def start_sender():
            return subprocess.Popen([options.bin_dir + "/eigencast-sender", "--no-progress", "play", "--wait", "torus", "--rate", "30", "--to",
                                     f"ws://127.0.0.1:{port}/soak/torus"], stderr=open(folder + "/sender.log", "a"))

        sender = start_sender()
        processes.append(sender)
        for _ in range(600):
            streams = ask(admin, "/api/streams")["streams"]
            if streams and streams[0]["keys_received"] > 0:
                break
            time.sleep(0.05)
        objects = [name for _, _, names in os.walk(folder + "/data") for name in names if re.fullmatch("[0-9a-f]{64}", name)]
        ask(admin, "/api/recordings/start?stream=soak/torus", b"")
        time.sleep(3)
        idle_fds = open_files(broker.pid)
        stop, counts = threading.Event(), {"came": 0, "stalled": 0, "downloaded": 0, "bytes": 0, "errors": 0, "last_error": ""}
        threads = [threading.Thread(target=viewer, args=(port, objects, stop, counts, seed)) for seed in range(options.viewers)]
        for thread in threads:
            thread.start()
        samples, begun, restarts = [], time.monotonic(), 0
        while time.monotonic() - begun < options.minutes * 60:
            stop.wait(2)
            samples.append(metrics(admin)["process_resident_memory_bytes"])
            if len(samples) % 15 == 0:  # The sender goes, too, without a word.
                sender.send_signal(signal.SIGKILL)
                sender.wait()
                sender = start_sender()
                processes.append(sender)
                restarts += 1
        stop.set()
        for thread in threads:
            thread.join()
        end_fds = None
        for _ in range(40):  # Stalled ones are noticed when the broker writes or pings.
            end_fds = open_files(broker.pid)
            if end_fds <= idle_fds + 2:
                break
            time.sleep(1)
        warm = samples[int(len(samples) * WARM_SHARE):]
        middle, last = median(warm[:len(warm) // 2]), median(warm[len(warm) // 2:])
        result = {"minutes": options.minutes, "viewers": options.viewers, "threads": options.threads, "came": counts["came"], "stalled": counts["stalled"],
                  "downloaded": counts["downloaded"], "errors": counts["errors"], "last_error": counts["last_error"], "sender_restarts": restarts,
                  "received_mb": round(counts["bytes"] / 1e6, 1),
                  "recorded_mb": round(metrics(admin)["eigencast_broker_recorded_bytes_total"] / 1e6, 2),
                  "rss_first_mb": round(samples[0] / 1e6, 2), "rss_middle_mb": round(middle / 1e6, 2),
                  "rss_last_mb": round(last / 1e6, 2), "fds_before": idle_fds, "fds_after": end_fds}
        complaints = []
        if broker.poll() is not None:
            complaints.append("the broker ended")
        if last > middle + max(1e6, 0.03 * middle):
            complaints.append("memory grew")
        if end_fds > idle_fds + 2:
            complaints.append("descriptors leaked")
        if counts["came"] < options.viewers or counts["errors"] > 0.01 * counts["came"]:
            complaints.append("viewers could not come")
        result["complaints"] = complaints
        print(json.dumps(result))
        return 1 if complaints else 0
    finally:
        for process in processes:
            if process.poll() is None:
                process.terminate()
                process.wait()


if __name__ == "__main__":
    raise SystemExit(main())
