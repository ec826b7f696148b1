#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Figure 8 of Zhang et al. 2013: bandwidth of one viewer by way of streaming: coefficients, geometry frame by frame, pictures.

Runs bench/peers/codec_peers on real clips. What must be there before the first pose (basis, faces) is a column of its own;
`paid_after_s` is when the stream of coefficients has made good for it against that row. Rows of remote rendering are taken
from remote_rendering.csv in --out, where bench/peers/remote_rendering.py has been run.
"""
import csv
import re
import subprocess

from common import ROOT, clip_argument, parser, pathlib, plt, skip, write_picture, write_table

# Error bounds over the diagonal, at which the error in all meets what each clip is to be shown with (docs/performance.md).
CLIPS = {"horse-gallop": 1.35e-3, "human-walk": 1e-3, "elephant-gallop": 1.35e-3}
RANK = 200
HEADER = ["clip", "vertices", "method", "bytes_per_frame", "kbit_per_s", "kg_percent", "first_bytes", "encode_us"]


def geometry_rows(options):
    if not options.peers.exists():
        skip(f"{options.peers} is not built (cmake --preset bench; ninja codec_peers), or --peers names another program")
    rows = []
    for name, error in CLIPS.items():
        done = subprocess.run([options.peers, clip_argument(options, name), str(RANK), str(error)], check=True, capture_output=True,
                              text=True)
        rows += csv.DictReader(done.stdout.splitlines())
    return rows


def remote_rows(options, rows):
    table = options.out / "remote_rendering.csv"
    if not table.exists():
        print(f"{table} is not there: no remote rendering")
        return []
    vertices = {row["clip"]: row["vertices"] for row in rows}
    with open(table) as file:
        return [{**dict.fromkeys(HEADER, ""), "clip": row["clip"], "vertices": vertices[row["clip"]],
                 "method": f"x264 crf {row['crf']}, {row['size']}", "kbit_per_s": row["kbit_per_s"], "first_bytes": "0",
                 "encode_us": f"{1000 * float(row['processor_ms']):.0f}"}
                for row in csv.DictReader(file) if row["clip"] in vertices]


def paid_after_s(row, rows):
    ours = next(r for r in rows if r["clip"] == row["clip"] and r["method"] == "eigencast")
    saved = (float(row["kbit_per_s"]) - float(ours["kbit_per_s"])) * 125
    extra = int(ours["first_bytes"]) - int(row["first_bytes"])
    return round(max(0.0, extra / saved), 2) if saved > 0 else ""


def draw(options, rows):
    clips = list(CLIPS)
    family = lambda row: re.sub(r" \d+ bit$", "", row["method"])
    methods = list(dict.fromkeys(family(row) for row in rows))
    figure, axes = plt.subplots(figsize=(11, 5))
    width = 0.9 / len(methods)
    for index, method in enumerate(methods):
        mine = [row for row in rows if family(row) == method]
        bars = axes.bar([clips.index(row["clip"]) + (index - len(methods) / 2 + 0.5) * width for row in mine],
                        [float(row["kbit_per_s"]) for row in mine], width, label=method)
        axes.bar_label(bars, [f"{float(row['kbit_per_s']):,.0f}" for row in mine], fontsize=6, rotation=90, padding=2)
    axes.set_yscale("log")
    axes.set_ylim(10, 2e6)
    axes.set_xticks(range(len(clips)), [f"{c}\n{next(r['vertices'] for r in rows if r['clip'] == c)} vertices" for c in clips])
    axes.set_ylabel("kbit/s of one viewer, 30 poses/s, payload")
    axes.set_title(f"Figure 8: geometry on the grid whose error is no larger than that of the coefficients (r = {RANK})", fontsize=10)
    axes.legend(fontsize=7, ncol=2, loc="upper left")
    write_picture(options, "figure_08", figure)


def main():
    p = parser(__doc__)
    p.add_argument("--peers", type=pathlib.Path, default=ROOT / "build/bench/bench/codec_peers", help="program of bench/peers")
    options = p.parse_args()
    rows = geometry_rows(options)
    rows += remote_rows(options, rows)
    write_table(options, "figure_08", [*HEADER, "paid_after_s"],
                [[*(row[name] for name in HEADER), paid_after_s(row, rows)] for row in rows])
    draw(options, rows)


if __name__ == "__main__":
    main()
