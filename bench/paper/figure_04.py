#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Figure 4 of Zhang et al. 2013: poses interpolated at lambda = 0.33 and 0.66 between two keys, as a viewer draws them.

Above what the broker interpolates between every third frame of a clip, below the clip's own frames. Clips are played slowly, so
that a viewer that draws without a GPU draws every pose, and the broker is set to bridge such pauses.
"""
import sys

from common import Stage, clip_argument, drawn, lines_of, parser, rms_over_diagonal, strip, watch, write_table

CLIPS = ("elephant-gallop", "horse-gallop")
CLIP_FRAMES = 48  # Of either; they are played again and again.
FRAMES = (15, 16, 17, 18)  # Keys are every third.
SLOWED = 10  # Frames of the clip take so many times as long.
LOD = 0.3  # As much as a picture of this size shows, drawn in time without a GPU.


def play(stage, clip, stream, query, keys_hz):
    """Pictures by frame of the clip, with so many keys a second of the clip's own time."""
    sent = stage.folder / f"{stream}.jsonl"
    sender = stage.start("eigencast-sender", "--no-progress", "play", "--wait", clip, "--rate", keys_hz / SLOWED, "--speed", 1 / SLOWED, "--to",
                         stage.url(stream), "--codec", "float64", "--record", sent)
    stage.wait_live(stream)
    viewer = watch(stage, stream, query, 22, "--view", "right", "--lod", LOD)  # The clip takes 16 s, and begins anew.
    pictures, report = drawn(stage, viewer)
    sender.terminate()
    sender.wait(20)
    first = lines_of(sent)[0]
    by_frame = {}
    for picture in pictures:
        frame = (picture["capture_us"] - first["capture_us"]) * 30e-6 / SLOWED + first["frame"]
        if abs(frame - round(frame)) < 0.02:
            by_frame.setdefault(round(frame) % CLIP_FRAMES, picture)
    return by_frame, report


def rows_of(stage, options, name):
    """Two rows of pictures, and the rows of the table."""
    clip = clip_argument(options, name)
    stage.bake(clip)
    made, report = play(stage, clip, f"{name}-keys", "rate=interpolated&k=3", 10)
    true, _ = play(stage, clip, f"{name}-all", "rate=raw", 30)
    missing = [frame for frame in FRAMES if frame not in made or frame not in true]
    if missing:
        sys.exit(f"{name}: frames {missing} were not drawn: the machine is too busy; try again")
    above, below, table = [], [], []
    for number, frame in enumerate(FRAMES):
        error = rms_over_diagonal(made[frame]["C"] - true[frame]["C"], report["surface"])
        kind = "key" if number in (0, 3) else f"interpolated, lambda = {(0.33, 0.66)[number - 1]}"
        above.append((made[frame]["png"], f"{kind}\nrms error {error:.2f} % of the diagonal"))
        below.append((true[frame]["png"], f"the clip's frame {frame}"))
        table.append([name, frame, kind, made[frame]["shown"], f"{error:.3f}"])
    return [above, below], table


def main():
    options = parser(__doc__).parse_args()
    rows, table = [], []
    with Stage(options, "--frames-max-span-ms", 2 * SLOWED * 100) as stage:
        for name in CLIPS:
            pictures, lines = rows_of(stage, options, name)
            rows += pictures
            table += lines
        strip(options, "figure_04", rows, "Figure 4: between two keys of 10 a second; below, the clips themselves")
    write_table(options, "figure_04", ["clip", "frame", "pose", "shown", "rms error %"], table)


if __name__ == "__main__":
    main()
