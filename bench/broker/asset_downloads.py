#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""How much later frames leave while assets are downloaded at full speed.

Usage: asset_downloads.py BIN_DIR [--viewers N] [--downloads N] [--seconds S] [--rounds R]

A broker, a sender of 30 poses a second, viewers, and rounds without and with downloads in turn. Prints a line of JSON for each
round: the broker's own histogram of the time from when a pose was to leave to its first write (upper bounds of the buckets that
hold median and 99th percentile, in ms; keys as they come, so that nothing waits on purpose), frames dropped, MB/s downloaded.
Needs curl.
"""
import argparse
import hashlib
import json
import os
import re
import shutil
import subprocess
import tempfile
import threading
import time
import urllib.request

OBJECT_BYTES = 64 << 20


def metrics(port):
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=10) as answer:
        lines = answer.read().decode().splitlines()
    return {name: float(value) for name, value in (line.rsplit(" ", 1) for line in lines if not line.startswith("#"))}


def quantile_ms(before, after, share):
    counts = []
    for name, value in after.items():
        found = re.fullmatch(r'eigencast_broker_frame_delay_seconds_bucket\{le="(.*)"\}', name)
        if found:
            counts.append((float(found[1]), value - before[name]))
    counts.sort()
    return next(bound * 1e3 for bound, count in counts if count >= share * counts[-1][1])


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("bin_dir")
    parser.add_argument("--viewers", type=int, default=20)
    parser.add_argument("--downloads", type=int, default=16)
    parser.add_argument("--seconds", type=float, default=8)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    folder = tempfile.mkdtemp(prefix="eigencast-downloads-")
    processes = [subprocess.Popen([options.bin_dir + "/eigencast-broker", "--listen", "127.0.0.1:0", "--admin-listen", "127.0.0.1:0",
                                   "--port-file", folder + "/port", "--data-dir", folder + "/data",
                                   "--timeouts-idle-ms", "3600000"], stderr=subprocess.DEVNULL)]  # curl answers no ping.
    try:
        while not os.path.exists(folder + "/port"):
            time.sleep(0.05)
        port, admin = (int(line) for line in open(folder + "/port").read().split())
        content = os.urandom(OBJECT_BYTES)
        url = f"http://127.0.0.1:{port}/v1/assets/{hashlib.sha256(content).hexdigest()}"
        urllib.request.urlopen(urllib.request.Request(url, data=content, method="PUT"), timeout=60).close()
        stream = f"ws://127.0.0.1:{port}/live/torus"
        processes.append(subprocess.Popen([options.bin_dir + "/eigencast-sender", "--no-progress", "play", "--wait", "torus", "--to", stream],
                                          stderr=subprocess.DEVNULL))
        for _ in range(options.viewers):
            processes.append(subprocess.Popen(["curl", "-sN", "-o", "/dev/null", "--http1.1", "-H", "Upgrade: websocket", "-H",
                                               "Connection: Upgrade", "-H", "Sec-WebSocket-Version: 13", "-H",
                                               "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==", "-H",
                                               "Sec-WebSocket-Protocol: eigencast.v2",
                                               f"http://127.0.0.1:{port}/v1/subscribe/live/torus?rate=raw"]))
        time.sleep(4)

        def download(stop):
            while not stop.is_set():
                subprocess.run(["curl", "-s", "-o", "/dev/null", url], check=True)

        for number in range(2 * options.rounds):
            loaded = number % 2 == 1
            stop = threading.Event()
            threads = [threading.Thread(target=download, args=(stop,)) for _ in range(options.downloads if loaded else 0)]
            for thread in threads:
                thread.start()
            before, begun = metrics(admin), time.monotonic()
            time.sleep(options.seconds)
            after, seconds = metrics(admin), time.monotonic() - begun
            stop.set()
            for thread in threads:
                thread.join()
            grown = {name: after[name] - before[name] for name in after if name in before}
            print(json.dumps({"downloads": len(threads), "viewers": options.viewers,
                              "frames": grown["eigencast_broker_frame_delay_seconds_count"],
                              "delay_p50_below_ms": quantile_ms(before, after, 0.5),
                              "delay_p99_below_ms": quantile_ms(before, after, 0.99),
                              "delay_mean_ms": round(1e3 * grown["eigencast_broker_frame_delay_seconds_sum"] /
                                                     grown["eigencast_broker_frame_delay_seconds_count"], 3),
                              "dropped": grown["eigencast_broker_frames_dropped_total"],
                              "mb_per_s": round(grown["eigencast_broker_download_bytes_total"] / seconds / 1e6)}), flush=True)
    finally:
        for process in processes:
            process.terminate()
        for process in processes:
            process.wait()
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
