#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Figure 13 of Zhang et al. 2013: poses estimated at lambda = 1, 2, 3 key intervals beyond the last key that came.

A sender stops for a while in the midst of a clip; what the broker's estimates (Eq. 9, and damped) then show is put beside the
clip's own frames.
"""
import subprocess
import sys
import time

from common import Stage, clip_argument, drawn, np, parser, rms_over_diagonal, strip, truth_of, watch, write_table

CLIP, FRAMES = "horse-gallop", 48
LAST = 20       # The last frame that is sent.
RATE_HZ = 16.0  # So that three intervals end before estimates do, after 200 ms.
STEPS = (1, 2, 3)


def estimated(stage, clip, poses, scheme):
    """Pictures of frames LAST + STEPS as estimated; None for those that were not drawn."""
    stream = f"{scheme}-{len(stage.running)}"
    viewer = watch(stage, stream, f"rate=estimated&k=2&scheme={scheme}", 11)
    sender = stage.start("eigencast-sender", "--no-progress", "pipe", clip, "--to", stage.url(stream), "--codec", "float64",
                         stdin=subprocess.PIPE)
    time.sleep(5)
    begin = time.monotonic()
    for number, pose in enumerate(poses[:LAST + 1]):
        time.sleep(max(0, begin + number / RATE_HZ - time.monotonic()))
        sender.stdin.write(pose.astype("<f4").tobytes())
        sender.stdin.flush()
    time.sleep(2)
    sender.stdin.close()
    pictures, report = drawn(stage, viewer)
    last_key = max((p["capture_us"] for p in pictures if p["shown"] == "live"), default=None)
    if last_key is None:
        sys.exit(f"{scheme}: no key was drawn; the machine is too busy")
    result = []
    for step in STEPS:
        near = [p for p in pictures if p["shown"] == "estimated" and
                abs((p["capture_us"] - last_key) * RATE_HZ * 1e-6 - step) < 0.3]
        result.append(min(near, key=lambda p: abs((p["capture_us"] - last_key) * RATE_HZ * 1e-6 - step), default=None))
    return result, report


def main():
    options = parser(__doc__).parse_args()
    clip = clip_argument(options, CLIP)
    poses = np.load(clip)
    rows, table = [], []
    with Stage(options) as stage:
        truth, surface = truth_of(stage, clip, FRAMES)
        for scheme, words in (("linear", "Eq. 9"), ("damped", "damped")):
            for _ in range(4):
                pictures, _ = estimated(stage, clip, poses, scheme)
                if all(pictures):
                    break
            else:
                sys.exit(f"{scheme}: not every estimate was drawn; the machine is too busy, try again")
            row = []
            for step, picture in zip(STEPS, pictures):
                error = rms_over_diagonal(picture["C"] - truth[LAST + step], surface)
                held = rms_over_diagonal(truth[LAST] - truth[LAST + step], surface)
                row.append((picture["png"], f"{words}, lambda = {step}\nrms error {error:.2f} %"))
                table.append([step, words, f"{error:.3f}", f"{held:.3f}"])
            rows.append(row)
        viewer = watch(stage, "true", "rate=raw", 14)
        sender = stage.start("eigencast-sender", "--no-progress", "play", clip, "--rate", 7, "--speed", 7 / 30, "--to",
                             stage.url("true"), "--codec", "float64")
        pictures, _ = drawn(stage, viewer)
        sender.terminate()
        sender.wait(20)
        row = []
        for step in STEPS:
            nearest = min(pictures, key=lambda p: np.linalg.norm(p["C"] - truth[LAST + step]))
            row.append((nearest["png"], f"the clip's frame {LAST + step}"))
        rows.append(row)
        strip(options, "figure_13", rows, f"Figure 13: {CLIP}, estimated beyond frame {LAST}")
    write_table(options, "figure_13", ["lambda", "scheme", "rms error %", "held instead %"], table)


if __name__ == "__main__":
    main()
