#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""A clip of 10,000 frames plays in bounded memory: its poses are streamed from disk, and what is kept of them has a bound.

Usage: long_clip_test.py BROKER SENDER
"""
import array
import math
import pathlib
import subprocess
import sys
import tempfile
import time

BROKER, SENDER = sys.argv[1:3]
SIDE = 48
FRAMES = (500, 10_000)
MOST_MORE_MB = 64  # of 263 MB that the long file has more: coefficients of up to 64 MiB are kept in memory, more go to a file


def write_clip(folder, frames):
    """A waving sheet as vertices.npy (T, n, 3) float32, faces.npy and nothing in memory but a frame."""
    folder.mkdir()

    def header(shape, kind):
        text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}"
        text += " " * (64 - (len(text) + 11) % 64) + "\n"
        return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()

    waves = 100  # so many different frames
    made = [array.array("f", [c for y in range(SIDE) for x in range(SIDE)
                              for c in (x / SIDE, y / SIDE, 0.1 * math.sin(6.2832 * (k / waves + x / SIDE)))]) for k in range(waves)]
    with open(folder / "vertices.npy", "wb") as out:
        out.write(header((frames, SIDE * SIDE, 3), "<f4"))
        for frame in range(frames):
            made[frame % waves].tofile(out)
    corners = array.array("i", [v for y in range(SIDE - 1) for x in range(SIDE - 1) for i in [y * SIDE + x]
                                for v in (i, i + 1, i + SIDE, i + 1, i + SIDE + 1, i + SIDE)])
    with open(folder / "faces.npy", "wb") as out:
        out.write(header((len(corners) // 3, 3), "<i4"))
        corners.tofile(out)
    return folder / "vertices.npy"


def peak_mb(pid):
    for line in pathlib.Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) / 1024
    return 0


def play(clip, url, cache):
    """Peak memory in MB by the time that it has sent some hundred poses."""
    log = open(clip.with_suffix(".log"), "wb")
    sender = subprocess.Popen([SENDER, "play", "--wait", clip, "--to", url, "--rate", "100", "--frames", "300", "--cache", cache], stderr=log)
    peak = 0
    end = time.monotonic() + 400
    while sender.poll() is None:
        if time.monotonic() > end:
            sender.kill()
            sys.exit("the clip was not played within 400 s")
        try:
            peak = max(peak, peak_mb(sender.pid))
        except (FileNotFoundError, ProcessLookupError):
            break
        time.sleep(0.05)
    if sender.wait() != 0:
        sys.exit(f"the sender ended with {sender.returncode}: {clip.with_suffix('.log').read_text()}")
    return peak


def main():
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        port = folder / "port"
        broker = subprocess.Popen([BROKER, "--listen", "127.0.0.1:0", "--admin-listen", "127.0.0.1:0", "--port-file", port, "--data-dir", folder / "assets"],
                                  stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        try:
            while not port.exists() or not port.read_text().endswith("\n"):
                time.sleep(0.05)
            url = f"ws://127.0.0.1:{port.read_text().split()[0]}/long"
            clips = [write_clip(folder / str(frames), frames) for frames in FRAMES]
            play(clips[0], url, folder / "cache")  # bakes: what the others find
            peaks = [play(clip, url, folder / "cache") for clip in clips]
        finally:
            broker.terminate()
            broker.wait()
    for frames, peak in zip(FRAMES, peaks):
        print(f"{frames:6} frames, {frames * SIDE * SIDE * 12 / 1e6:5.0f} MB: {peak:.0f} MB at most")
    if peaks[1] - peaks[0] > MOST_MORE_MB:
        sys.exit(f"the long clip takes {peaks[1] - peaks[0]:.0f} MB more, at most {MOST_MORE_MB} are allowed")


main()
