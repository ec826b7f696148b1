#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Figure 10 and Table II of Zhang et al. 2013: errors of rebuilt animations, lengths of normal displacements, and the bar.

figure_10a: the Hausdorff distance of each frame of two gallops, of the paper's way and of ours. figure_10b: how long the paper's
displacement vectors are at 200 vertices. figure_10_methods: six ways of bringing detail back, deformation transfer among them, at
the same 200 coefficients an axis. table_two: the bar, bent and twisted, beside the paper's figures. The paper prints no numbers
for Figure 10; its text says that the bar has far smaller details and errors than horse and elephant, which is held against here.
"""
import csv
import subprocess

from common import bench_parser, bench_program, clip_argument, np, plt, write_picture, write_table

CLIPS = ("horse-gallop", "elephant-gallop")
RANK = 200
COLOURS = {"base only": "0.6", "world axes": "tab:olive", "normal (paper)": "tab:red", "frames": "tab:orange",
           "deformation transfer": "tab:purple", "augmented": "tab:blue"}


def lines_of(options):
    """CSV lines of detail_methods by their kind, clips by their names."""
    paths = {clip_argument(options, name): name for name in CLIPS}
    done = subprocess.run([bench_program(options, "detail_methods"), str(RANK), *paths, "box"], check=True, capture_output=True, text=True)
    kinds = {"method": [], "frame": [], "height": []}
    for kind, clip, *values in csv.reader(done.stdout.splitlines()):
        kinds[kind].append([paths.get(clip, "bar" if clip == "box" else clip), *values])
    return kinds


def draw_frames(options, rows):
    figure, axes = plt.subplots(1, len(CLIPS), figsize=(5.5 * len(CLIPS), 4.2), sharey=True, layout="constrained")
    for axis, clip in zip(axes, CLIPS):
        for method, colour in COLOURS.items():
            mine = [(int(frame), float(error)) for name, way, frame, error in rows if name == clip and way == method]
            axis.plot(*zip(*mine), color=colour, label=method)
        axis.set_title(clip, fontsize=10)
        axis.set_xlabel("frame")
    axes[0].set_ylabel("Hausdorff distance / diagonal")
    axes[0].legend(fontsize=7)
    figure.suptitle(f"Figure 10a: distortion of the rebuilt animations, r = {RANK}", fontsize=10)
    write_picture(options, "figure_10a", figure)


def draw_heights(options, rows):
    figure, axis = plt.subplots(figsize=(7, 4.2), layout="constrained")
    for clip in (*CLIPS, "bar"):
        lengths = sorted((float(length) for name, _, length in rows if name == clip), reverse=True)
        axis.plot(lengths, label=f"{clip}: median {np.median(lengths):.1e}")
    axis.set_yscale("log")
    axis.set_ylim(1e-6, 1e-1)
    axis.set_xlabel("sampled vertices, longest first")
    axis.set_ylabel("length of the normal displacement / diagonal")
    axis.legend(fontsize=8)
    axis.set_title(f"Figure 10b: displacement vectors, r = {RANK}", fontsize=10)
    write_picture(options, "figure_10b", figure)


def table_two(options):
    done = subprocess.run([bench_program(options, "table_two")], check=True, capture_output=True, text=True)
    lines = [[cell.strip() for cell in line.strip("| ").split("|")] for line in done.stdout.splitlines() if line.startswith("|")]
    write_table(options, "table_two", ["pose", "surface", "base", "normal (paper)", "augmented", "the paper's own"],
                [line for line in lines[2:]])


def main():
    p = bench_parser(__doc__)
    options = p.parse_args()
    kinds = lines_of(options)
    write_table(options, "figure_10_methods", ["clip", "method", "kg_percent", "rms", "max", "kg_percent_at_rest"], kinds["method"])
    with open(options.out / "figure_10a.csv", "w", newline="") as file:
        csv.writer(file).writerows([["clip", "method", "frame", "hausdorff"], *kinds["frame"]])
    with open(options.out / "figure_10b.csv", "w", newline="") as file:
        csv.writer(file).writerows([["clip", "vertex", "length"], *kinds["height"]])
    draw_frames(options, kinds["frame"])
    draw_heights(options, kinds["height"])
    table_two(options)


if __name__ == "__main__":
    main()
