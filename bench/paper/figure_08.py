#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Figure 8 of Zhang et al. 2013: bandwidth of one viewer by way of streaming: coefficients, geometry frame by frame, pictures.

Runs bench/peers/codec_peers on real clips, and `eigencast-sender evaluate --again` for their second pass (0.87 of the speed, noise
5e-4) with what streams remember and learn. A second picture has the rows "without ...": one mechanism off. What must be there before the first pose (basis, faces) is a column of its own;
`paid_after_s` is when the stream of coefficients has made good for it against that row. Rows of remote rendering are taken
from remote_rendering.csv in --out, where bench/peers/remote_rendering.py has been run.
"""
import csv
import json
import re
import subprocess
import tempfile

from learning import positions_of
from common import ROOT, clip_argument, parser, pathlib, plt, np, skip, write_picture, write_table

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


def repeated_rows(options, rows):
    """Of each clip's second pass: all that there is, and without the newer of its parts."""
    made = []
    for name, error in CLIPS.items():
        rest = positions_of(options.data / "animations" / name / "rest.obj")
        with tempfile.TemporaryDirectory() as folder:
            report = pathlib.Path(folder) / "report.json"
            subprocess.run([options.bin / "eigencast-sender", "--no-progress", "evaluate", clip_argument(options, name), "--rank", str(RANK), "--error",
                            str(error * np.linalg.norm(rest.max(0) - rest.min(0))), "--again", "--warp", "0.87", "--noise", "5e-4", "--learn", "4",
                            "--json", report], check=True, stdout=subprocess.DEVNULL)
            result = json.loads(report.read_text())["results"][0]
        learnt, first = result["learn"], result["asset_bytes"]
        memory = result["again"]["memory_bytes"]
        for method, part, extra in (("second pass", "with_columns_and_memory", memory + learnt["side_bytes"]),
                                    ("second pass without columns", "with_memory", memory),
                                    ("second pass without memory, columns", "without_columns_and_memory", 0)):
            judged = learnt["again"][part]
            made.append({"clip": name, "vertices": next(r["vertices"] for r in rows if r["clip"] == name), "method": method,
                         "bytes_per_frame": f"{judged['payload_kbit_per_s'] * 125 / 30:.1f}", "kbit_per_s": f"{judged['payload_kbit_per_s']:.1f}",
                         "kg_percent": f"{judged['error']['kg_percent']:.4f}", "first_bytes": str(first + extra),
                         "encode_us": f"{judged['encode_us_p50']:.1f}"})
    return made


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


def draw_ablations(options, rows):
    """Bits and error of each row over those of the stream as it is, in its pass."""
    figure, axes = plt.subplots(1, 2, figsize=(11, 4), sharey=True)
    methods = [m for m in dict.fromkeys(row["method"] for row in rows) if "without" in m]
    for index, clip in enumerate(CLIPS):
        of = {row["method"]: row for row in rows if row["clip"] == clip}
        whole = lambda method: of["second pass" if method.startswith("second") else "eigencast"]
        for axis, field in zip(axes, ("kbit_per_s", "kg_percent")):
            axis.barh([m + 0.27 * (index - 1) for m in range(len(methods))], [float(of[m][field]) / float(whole(m)[field]) for m in methods], 0.25,
                      label=clip)
    axes[0].set_yticks(range(len(methods)), methods)
    for axis, title in zip(axes, ("bits, of the whole", "KG error, of the whole")):
        axis.axvline(1, color="black", linewidth=0.5)
        axis.set_title(title, fontsize=10)
    axes[1].legend(fontsize=7)
    write_picture(options, "figure_08_ablations", figure)


def draw(options, rows):
    rows = [row for row in rows if "without" not in row["method"]]
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
    axes.set_ylim(1, 2e6)
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
    rows += repeated_rows(options, rows)
    rows += remote_rows(options, rows)
    write_table(options, "figure_08", [*HEADER, "paid_after_s"],
                [[*(row[name] for name in HEADER), paid_after_s(row, rows)] for row in rows])
    draw(options, rows)
    draw_ablations(options, rows)


if __name__ == "__main__":
    main()
