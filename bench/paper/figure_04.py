#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Figure 4 of Zhang et al. 2013: poses interpolated at lambda = 0.33 and 0.66 between two keys, as a viewer draws them.

Above what the broker interpolates between every third frame of the clip, below the clip's own frames. The clip is played
slowly, so that a viewer that draws without a graphics card draws every pose.
"""
from common import Stage, clip_argument, drawn, lines_of, parser, rms_over_diagonal, strip, watch, write_table
import sys

CLIP = "horse-gallop"
FRAMES = (12, 13, 14, 15)  # Keys are every third.


def play(stage, clip, stream, query, rate):
    """Pictures by frame of the clip (thirds of a key interval apart), of a clip slowed to 9 frames a second."""
    viewer = watch(stage, stream, query, 14)
    sent = stage.folder / f"{stream}.jsonl"
    sender = stage.start("eigencast-sender", "--no-progress", "play", clip, "--rate", rate, "--speed", 0.3, "--to",
                         stage.url(stream), "--codec", "float64", "--record", sent)
    pictures, report = drawn(stage, viewer)
    sender.terminate()
    sender.wait(20)
    first = lines_of(sent)[0]
    by_frame = {}
    for picture in pictures:
        frame = (picture["capture_us"] - first["capture_us"]) * 9e-6 + first["frame"]
        if abs(frame - round(frame)) < 0.02:
            by_frame.setdefault(round(frame), picture)
    return by_frame, report


def main():
    options = parser(__doc__).parse_args()
    clip = clip_argument(options, CLIP)
    with Stage(options) as stage:
        made, report = play(stage, clip, "keys", "rate=interpolated&k=3", 3)
        true, _ = play(stage, clip, "all", "rate=raw", 9)
        missing = [frame for frame in FRAMES if frame not in made or frame not in true]
        if missing:
            sys.exit(f"frames {missing} were not drawn: the machine is too busy; try again")
        rows, table = [[], []], []
        for number, frame in enumerate(FRAMES):
            error = rms_over_diagonal(made[frame]["C"] - true[frame]["C"], report["surface"])
            kind = "key" if number in (0, 3) else f"interpolated, lambda = {number / 3:.2f}"
            rows[0].append((made[frame]["png"], f"{kind}\nrms error {error:.2f} % of the diagonal"))
            rows[1].append((true[frame]["png"], f"the clip's frame {frame}"))
            table.append([frame, kind, made[frame]["shown"], f"{error:.3f}"])
        strip(options, "figure_04", rows, f"Figure 4: {CLIP}, between two keys of 10 a second")
    write_table(options, "figure_04", ["frame", "pose", "shown", "rms error %"], table)


if __name__ == "__main__":
    main()
