#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Figure 13 of Zhang et al. 2013: poses estimated at lambda = 1, 2, 3 key intervals beyond the last key that came.

A sender falls silent in the midst of a clip; what the broker's estimates (Eq. 9, and damped) then show is put beside the clip's
own frames. The clip is played at a tenth of its pace, so that a viewer that draws without a GPU draws every pose; the
broker is set to estimate for as much longer.
"""
import subprocess
import sys
import time

from common import Stage, clip_argument, drawn, np, parser, pathlib, rms_over_diagonal, strip, truth_of, watch, write_table

CLIP, FRAMES = "horse-gallop", 48
LAST = 20      # The last frame that is sent.
KEYS_HZ = 3.0  # In place of 30.
STEPS = (1, 2, 3)
VIEW = ("--view", "right", "--lod", 0.4)  # As much as a picture of this size shows, drawn in time without a GPU.


def nearest(pictures, capture_us):
    """What was drawn of that media time, or nothing."""
    near = [p for p in pictures if abs(p["capture_us"] - capture_us) < 0.05e6 / KEYS_HZ]
    return min(near, key=lambda p: abs(p["capture_us"] - capture_us), default=None)


def estimated(stage, clip, poses, scheme):
    """The pictures of frames LAST + STEPS as estimated."""
    sender = stage.start("eigencast-sender", "--no-progress", "pipe", "--mesh", pathlib.Path(clip).with_name("rest.obj"), "--to",
                         stage.url(scheme), "--codec", "float64", stdin=subprocess.PIPE)
    stage.wait_live(scheme)
    viewer = watch(stage, scheme, f"rate=estimated&k=2&scheme={scheme}", 14, *VIEW)
    time.sleep(3)
    begin = time.monotonic()
    for number, pose in enumerate(poses[:LAST + 1]):
        time.sleep(max(0, begin + number / KEYS_HZ - time.monotonic()))
        sender.stdin.write(pose.astype("<f4").tobytes())
        sender.stdin.flush()
    time.sleep(2)
    sender.stdin.close()
    pictures, _ = drawn(stage, viewer)
    keys = [p for p in pictures if p["shown"] == "live"]
    if not keys:
        sys.exit(f"{scheme}: no key was drawn; the machine is too busy")
    result = [nearest(pictures, keys[-1]["capture_us"] + step * 1e6 / KEYS_HZ) for step in STEPS]
    if not all(result):
        sys.exit(f"{scheme}: not every estimate was drawn; the machine is too busy, try again")
    return result


def clip_itself(stage, clip, truth):
    """Pictures of the clip's own frames LAST and LAST + STEPS."""
    sender = stage.start("eigencast-sender", "--no-progress", "play", "--wait", clip, "--rate", 3, "--speed", 0.1, "--to",
                         stage.url("true"), "--codec", "float64")
    stage.wait_live("true")
    viewer = watch(stage, "true", "rate=raw", 18, *VIEW)
    pictures, _ = drawn(stage, viewer)
    sender.terminate()
    sender.wait(20)
    result = [min(pictures, key=lambda p: np.linalg.norm(p["C"] - truth[LAST + step])) for step in (0, *STEPS)]
    if any(np.linalg.norm(picture["C"] - truth[LAST + step]) > 1e-6 for step, picture in zip((0, *STEPS), result)):
        sys.exit("not every frame of the clip was drawn; the machine is too busy, try again")
    return result


def check(C, truth, step, surface):
    """What the viewer drew is Eq. 9 of the clip's frames."""
    off = rms_over_diagonal(C - (truth[LAST] + step * (truth[LAST] - truth[LAST - 1])), surface)
    if off > 0.02:
        sys.exit(f"lambda = {step}: the picture is {off:.2f} % off Eq. 9; did a key get lost?")


def main():
    options = parser(__doc__).parse_args()
    clip = clip_argument(options, CLIP)
    poses = np.load(clip)
    rows, table = [], []
    with Stage(options, "--frames-max-ahead-ms", 2000) as stage:
        truth, surface = truth_of(stage, clip, FRAMES)
        own = clip_itself(stage, clip, truth)
        for scheme, words in (("linear", "Eq. 9"), ("damped", "damped 27/32")):
            row = [(own[0]["png"], f"last key, frame {LAST}")]
            for step, picture in zip(STEPS, estimated(stage, clip, poses, scheme)):
                if scheme == "linear":
                    check(picture["C"], truth, step, surface)
                error = rms_over_diagonal(picture["C"] - truth[LAST + step], surface)
                held = rms_over_diagonal(truth[LAST] - truth[LAST + step], surface)
                row.append((picture["png"], f"{words}, lambda = {step}\nrms error {error:.2f} % (held: {held:.2f} %)"))
                table.append([step, words, f"{error:.3f}", f"{held:.3f}"])
            rows.append(row)
        rows.append([(picture["png"], f"the clip's frame {LAST + step}") for step, picture in zip((0, *STEPS), own)])
        strip(options, "figure_13", rows, f"Figure 13: {CLIP}, 30 keys a second, estimated beyond frame {LAST}")
    write_table(options, "figure_13", ["lambda", "scheme", "rms error %", "held instead %"], table)


if __name__ == "__main__":
    main()
