#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Remote rendering as a peer of the coefficient stream: eigencast-client's pictures of a clip, one for each pose, coded as video at 30/s
by x264 (-tune zerolatency: no frame waits for a later one) at two qualities.

    remote_rendering.py BIN_FOLDER CLIP [--size 1440x900]

Poses are sent slowly, so that a processor without a GPU draws all of them; the video takes them at 30/s. The delay is the time that
the encoder takes for a picture, drawing and reading PNG files not counted."""

import argparse
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import time

POSES_PER_S, PICTURES_PER_S = 4, 30


def draw(folder, clip, size, pictures, data):
    """Fills `pictures` with frame_0001.png and on; returns how many."""
    port_file = data / "port"
    broker = subprocess.Popen([folder / "eigencast-broker", "--listen", "127.0.0.1:0", "--admin-listen", "", "--data-dir", data / "broker",
                               "--port-file", port_file, "--log-level", "error"])
    sender = None
    try:
        for _ in range(100):
            time.sleep(0.1)
            if port_file.exists() and port_file.read_text().strip():
                break
        url = f"ws://127.0.0.1:{port_file.read_text().split()[0].rsplit(':', 1)[-1]}/peer"
        sender = subprocess.Popen([folder / "eigencast-sender", "--no-progress", "play", clip, "--rate", str(POSES_PER_S), "--cache",
                                   data / "cache", "--to", url], stderr=subprocess.DEVNULL)
        subprocess.run([folder / "eigencast-client", url, "--headless", "--frames", "40", "--rate", "raw", "--size", size, "--out", pictures,
                        "--cache", data / "cache"], check=True, timeout=90, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    finally:
        for process in filter(None, [sender, broker]):
            process.terminate()
            process.wait()
    return len(list(pictures.glob("frame_*.png")))


def code(pictures, raw, size, count, quality):
    """kbit/s, and milliseconds of the encoder for one picture."""
    video = pictures / f"{quality}.h264"
    done = subprocess.run(["ffmpeg", "-hide_banner", "-y", "-benchmark", "-f", "rawvideo", "-pix_fmt", "yuv420p", "-s", size, "-r", str(PICTURES_PER_S),
                           "-i", raw, "-c:v", "libx264", "-tune", "zerolatency", "-crf", str(quality), "-f", "h264", video],
                          check=True, capture_output=True, text=True)
    seconds = float(re.search(r"rtime=([0-9.]+)s", done.stderr)[1])
    return video.stat().st_size * 8e-3 * PICTURES_PER_S / count, 1000 * seconds / count


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("clip")
    parser.add_argument("--size", default="1440x900")
    arguments = parser.parse_args()
    if not shutil.which("ffmpeg"):
        print("SKIPPED: no ffmpeg, so nothing to compare with", file=sys.stderr)
        return 0
    with tempfile.TemporaryDirectory() as scratch:
        data = pathlib.Path(scratch)
        pictures = data / "pictures"
        count = draw(arguments.folder.resolve(), arguments.clip, arguments.size, pictures, data)
        raw = data / "pictures.yuv"
        subprocess.run(["ffmpeg", "-hide_banner", "-loglevel", "error", "-i", pictures / "frame_%04d.png", "-pix_fmt", "yuv420p", "-f", "rawvideo", raw],
                       check=True)
        for quality in (23, 30):
            rate, delay = code(pictures, raw, arguments.size, count, quality)
            print(f"x264 zerolatency crf {quality}, {arguments.size} at {PICTURES_PER_S}/s, {count} pictures: {rate:.0f} kbit/s, {delay:.1f} ms a picture")
    return 0


if __name__ == "__main__":
    sys.exit(main())
