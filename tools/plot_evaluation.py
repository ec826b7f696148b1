#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Draws a report of `eigencast-sender evaluate --json REPORT`: error by frame, rank, bit rate and level of detail, where there are two
points or more, and the bits and errors of which a rank was chosen. Needs python3-matplotlib.

    tools/plot_evaluation.py REPORT FOLDER
"""
import json
import pathlib
import sys

import matplotlib
matplotlib.use("Agg")
import matplotlib.pyplot as plt


def draw(path, title, x_label, y_label, lines, log_x=True, mark=None):
    """lines: points (x, y) by name; mark: a point that is set apart, and its name"""
    lines = {name: sorted(points) for name, points in lines.items() if len({x for x, _ in points}) > 1}
    if not lines:
        return
    figure, axes = plt.subplots(figsize=(10, 6), layout="constrained")
    for name, points in lines.items():
        axes.plot(*zip(*points), marker="o" if len(points) <= 40 else "", label=name)
    if mark:
        axes.plot(*mark[0], marker="*", markersize=18, color="black", linestyle="", label=mark[1])
    axes.set(title=title, xlabel=x_label, ylabel=y_label, yscale="log", xscale="log" if log_x else "linear")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=120)
    print(path)


def by(rows, name, x):
    lines = {}
    for row in rows:
        lines.setdefault(name(row), []).append((x(row), row["total"]["rms_over_diagonal"]))
    return lines


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    report, folder = json.loads(pathlib.Path(sys.argv[1]).read_text()), pathlib.Path(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    rows, clip = report["results"], report["input"]

    def basis(row):
        return f"{row['basis']} {row['rank']}"

    def coded(row):
        return f"{basis(row)}, error {row['error_over_diagonal']:.1e}"

    draw(folder / "error_by_frame.png", f"Error of each frame at full detail: {clip}", "frame", "rms / diagonal",
         {coded(row): list(enumerate(row["rms_over_diagonal_by_frame"])) for row in rows}, log_x=False)
    draw(folder / "error_by_rank.png", f"Error at full detail: {clip}", "coefficients an axis", "rms / diagonal",
         by(rows, lambda row: f"{row['basis']}, error {row['error_over_diagonal']:.1e}", lambda row: row["rank"]))
    draw(folder / "error_by_rate.png", f"Error and rate: {clip}", f"kbit/s at {report['rate_hz']:g} poses/s", "rms / diagonal",
         by(rows, basis, lambda row: row["wire_kbit_per_s"]))
    draw(folder / "error_by_level.png", f"Level of detail: {clip}", "fraction of the vertices", "Hausdorff / diagonal",
         {coded(row): [(level["lod"], level["hausdorff_over_diagonal"]) for level in row["levels"]] for row in rows})

    for row in rows:
        if "trial" in row:
            sweep(folder / f"sweep_{row['basis'].replace('/', '_')}.png", clip, row["trial"])
        if "loop" in row:
            loop = row["loop"]
            draw(folder / f"loop_{basis(row).replace(' ', '_').replace('/', '_')}.png", f"Played in a loop: {clip}", "s", "kbit/s with headers",
                 {f"with a memory, {loop['in_all_kbit_per_s']:.1f} kbit/s in all": list(enumerate(loop["kbit_per_s_by_second"])),
                  "without": list(enumerate(loop["kbit_per_s_by_second_without_memory"]))}, log_x=False)


def sweep(path, clip, trial):
    def point(p):
        return p["wire_kbit_per_s"], p["rms_over_diagonal"]

    def name(p):
        return f"r = {p['rank']}" + (f", {p['products']} groups of products" if p["products"] else "")

    lines = {}
    for p in trial["points"]:
        lines.setdefault(name(p), []).append(point(p))
    chosen = trial["chosen"]
    asked = f"{trial['asked']:.1f} kbit/s" if trial["is_rate"] else f"{trial['asked']:.2e}"
    draw(path, f"Error and rate on sample poses: {clip}", "kbit/s with headers", "rms / diagonal", lines,
         mark=(point(chosen), f"chosen for {asked}: {name(chosen)}, coded to within {chosen['error_over_diagonal']:.1e}"))


if __name__ == "__main__":
    main()
