#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Figure 1 of Zhang et al. 2013: four deforming surfaces, one of them as points, each at three levels of detail at once: three
viewers that watch the same streams of one broker.

Each row is one viewer, each column one stream. Rows of one column show the same capture time.
"""
import json
import shutil

from common import Stage, clip_argument, lines_of, parser, strip, write_table

CLIPS = ("horse-gallop", "elephant-gallop", "human-walk", "fox-run")
AS_POINTS = "elephant-gallop"
LEVELS = (1.0, 0.15, 0.03)
KEYS_HZ = 2  # So slowly that three viewers without a GPU draw every pose.


def played(stage, options, name):
    """The sender's argument: points are a clip whose faces are not beside it."""
    clip = clip_argument(options, name)
    if name != AS_POINTS:
        return clip
    folder = stage.folder / "points"
    folder.mkdir()
    shutil.copy(clip, folder / "vertices.npy")
    return str(folder / "vertices.npy")


def viewer(stage, name, level):
    folder = stage.folder / f"{name}-{level}"
    folder.mkdir()
    started = stage.start("eigencast-client", stage.url(name) + "?rate=raw", "--headless", "--size", "420x420", "--duration", stage.options.seconds, "--wait", 60,
                          "--lod", level, "--view", "iso", "--out", folder, "--record-shown", folder / "shown.jsonl", "--json",
                          folder / "report.json")
    started.folder = folder
    return started


def column(stage, options, name):
    """The pictures of one stream, one for each level, of the last pose that all viewers drew at their level; and the rows of the table.

    Poses that a viewer drew while it was still reading the surface, coarser than its level, do not count.
    """
    clip = played(stage, options, name)
    stage.bake(clip)
    viewers = [viewer(stage, name, level) for level in LEVELS]
    sender = stage.start("eigencast-sender", "--no-progress", "play", "--wait", clip, "--rate", KEYS_HZ, "--speed", KEYS_HZ / 30, "--to",
                         stage.url(name))
    pictures, rows, drawn = [], [], []
    for each in viewers:
        stage.wait(each, 120)
        lines = lines_of(each.folder / "shown.jsonl")
        drawn.append({line["capture_us"]: f"frame_{i + 1:04d}.png" for i, line in enumerate(lines)
                      if line["vertices"] == lines[-1]["vertices"]})
    sender.terminate()
    sender.wait(20)
    common = sorted(set.intersection(*map(set, drawn)))
    if not common:
        raise SystemExit(f"{name}: no pose was drawn by all three viewers at their levels: the machine is too busy; try again, or with --seconds")
    for each, level, shown in zip(viewers, LEVELS, drawn):
        report = json.loads((each.folder / "report.json").read_text())
        lod = report["lod"]
        kind = "points" if name == AS_POINTS else f"{lod['faces']:,} faces"
        pictures.append((each.folder / shown[common[-1]], f"{lod['vertices']:,} vertices, {kind}"))
        rows.append([name, level, lod["vertices"], lod["of"], lod["faces"], f"{report['kbit_per_s']:.1f}", len(shown)])
    return pictures, rows


def main():
    p = parser(__doc__)
    p.add_argument("--seconds", type=float, default=20, help="that each stream is watched")
    options = p.parse_args()
    columns, table = [], []
    with Stage(options) as stage:
        for name in CLIPS:
            pictures, rows = column(stage, options, name)
            columns.append(pictures)
            table += rows
        strip(options, "figure_01", [list(row) for row in zip(*columns)],
              "Figure 1: each column is one stream in three viewers at once; the second as points")
    write_table(options, "figure_01", ["stream", "level", "vertices", "of", "faces", "kbit/s", "poses drawn"], table)


if __name__ == "__main__":
    main()
