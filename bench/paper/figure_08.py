#!/usr/bin/python3
# SPDX-License-Identifier: MIT
"""Figure 8: bandwidth of one viewer by way of streaming: coefficients, or geometry frame by frame.

    figure8.py CODEC_PEERS OUT_FOLDER CLIP... [--plot-only]

CODEC_PEERS is the program of bench/peers; a CLIP is a vertices.npy. Writes figure8.csv and, where matplotlib is installed
(python3-matplotlib), figure8.png. Bytes of what must be there before the first pose (basis, faces) are a column of their own;
`paid_after_s` is when the stream of coefficients has made good for them against that row.
"""
import csv
import pathlib
import re
import subprocess
import sys


def geometry_rows(program, clips):
    rows = []
    for clip in clips:
        text = subprocess.run([program, clip], check=True, capture_output=True, text=True).stdout
        rows += csv.DictReader(text.splitlines())
    return rows


def add_pay_off(rows):
    for row in rows:
        ours = next(r for r in rows if r["clip"] == row["clip"] and r["method"] == "eigencast")
        saved = (float(row["kbit_per_s"]) - float(ours["kbit_per_s"])) * 125
        extra = int(ours["first_bytes"]) - int(row["first_bytes"])
        row["paid_after_s"] = round(max(0.0, extra / saved), 2) if saved > 0 and row["method"] != "eigencast" else ""
    return rows


def plot(rows, path):
    try:
        import matplotlib
    except ImportError:
        print("SKIPPED: no python3-matplotlib, so no picture", file=sys.stderr)
        return
    matplotlib.use("Agg")
    from matplotlib import pyplot

    clips = list(dict.fromkeys(row["clip"] for row in rows))
    family = lambda row: re.sub(r" \d+ bit$", "", row["method"])
    methods = list(dict.fromkeys(family(row) for row in rows))
    figure, axes = pyplot.subplots(figsize=(10, 5))
    width = 0.9 / len(methods)
    for index, method in enumerate(methods):
        mine = [row for row in rows if family(row) == method]
        bars = axes.bar([clips.index(row["clip"]) + (index - len(methods) / 2 + 0.5) * width for row in mine],
                        [float(row["kbit_per_s"]) for row in mine], width, label=method)
        axes.bar_label(bars, [f"{float(row['kbit_per_s']):,.0f}" for row in mine], fontsize=6, rotation=90, padding=2)
    axes.set_yscale("log")
    axes.set_ylim(10, 1e6)
    axes.set_xticks(range(len(clips)), [f"{c}\n{next(r['vertices'] for r in rows if r['clip'] == c)} vertices" for c in clips])
    axes.set_ylabel("kbit/s of one viewer, 30 poses/s, payload")
    axes.set_title("Geometry codecs at the grid whose error is no larger than that of the coefficients (r = 200)", fontsize=10)
    axes.legend(fontsize=7, ncol=2, loc="upper left")
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main(arguments):
    program, out, rest = arguments[0], pathlib.Path(arguments[1]), arguments[2:]
    out.mkdir(parents=True, exist_ok=True)
    table = out / "figure8.csv"
    if "--plot-only" not in rest:
        rows = geometry_rows(program, [a for a in rest if not a.startswith("--")])
        rows = add_pay_off(rows)
        with open(table, "w", newline="") as file:
            writer = csv.DictWriter(file, rows[0].keys())
            writer.writeheader()
            writer.writerows(rows)
    with open(table) as file:
        rows = list(csv.DictReader(file))
    print(table.read_text())
    plot(rows, out / "figure8.png")
    return 0


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    sys.exit(main(sys.argv[1:]))
