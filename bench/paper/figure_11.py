#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Figure 11 of Zhang et al. 2013: the delay from pose to surface, local and remote, over the level of detail, heart model.

Each point is a run of eigencast-latency on one clock: sender, broker and viewer on this machine, the remote viewer behind a relay
that does what the link named does; and once through to the picture, drawn off the screen. The paper has 2.7 ms for the local user
and 40-45 ms for remote users on a LAN. --viewers runs some of them: rows of the others stay in the table as they are, and with none the figure
is only drawn again.
"""
import csv
import json
import subprocess

from common import Stage, parser, plt, write_picture, write_table

LEVELS = (0.1, 0.25, 0.5, 0.75, 1.0)
PICTURE = "480x360"
VIEWERS = {"local": (None, []), "wlan": ("wlan", []), "3g": ("3g", []), "picture": (None, ["--present", PICTURE])}
TITLES = {"local": "local", "wlan": "remote, 20 +- 5 ms", "3g": "remote, 2 Mbit/s, 100 ms", "picture": f"local, to a picture of {PICTURE}"}
PAPER_LOCAL_MS, PAPER_REMOTE_MS = 2.7, (40, 45)
PARTS = {"sender: transform and encode": ("schedule", "transform", "encode"),
         "network": ("to_broker", "to_client"),
         "broker": ("interpolation_hold", "jitter_margin", "in_broker"),
         "viewer: decode and hand over": ("decode", "hand_over"),
         "reconstruct": ("reconstruct",),
         "picture": ("present",)}
STAGES = [stage for members in PARTS.values() for stage in members]
HEADER = ["viewer", "level", "vertices", "poses", "least_ms", "p50_ms", "p90_ms", "max_ms", *(f"{stage}_p50_ms" for stage in STAGES)]


def measure(options, stage, viewer, level):
    link, more = VIEWERS[viewer]
    report, name = stage.folder / "latency.json", f"{viewer}-{level}"
    arguments = [stage.program("eigencast-latency"), "loop", stage.url(name), "--source", "heart", "--lod", level, "--duration",
                 options.seconds, "--warmup", 1, "--no-progress", "--json", report, *more]
    if link:
        arguments += ["--viewer-url", stage.url(name, stage.relay(link))]
    done = subprocess.run([str(a) for a in arguments], capture_output=True, text=True, timeout=90)
    if done.returncode != 0:
        raise SystemExit(f"eigencast-latency ended with {done.returncode}:\n{done.stdout}\n{done.stderr}")
    return json.loads(report.read_text())


def row_of(viewer, level, report):
    milliseconds = lambda histogram, p: None if histogram[f"{p}_us"] is None else round(histogram[f"{p}_us"] / 1000, 3)
    keys, stages = report["keys"], report["traced"]["keys"]["stages"]
    # Of fewer than 100 poses the 90th percentile is luck, and null.
    return dict(zip(HEADER, [viewer, level, report["vertices_rebuilt"], keys["count"],
                             *(milliseconds(keys, p) for p in ("min", "p50", "p90", "max")),
                             *(milliseconds(stages[s], "p50") for s in STAGES)]))


def earlier_rows(options):
    table = options.out / "figure_11.csv"
    if not table.exists():
        return []
    with open(table) as file:
        rows = list(csv.DictReader(file))
    if rows and list(rows[0]) != HEADER:
        return []
    return [{name: (value if name == "viewer" else float(value) if value else None) for name, value in row.items()} for row in rows]


def draw(options, rows):
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 4.6))
    for viewer in ("local", "wlan", "3g"):
        own = [row for row in rows if row["viewer"] == viewer]
        left.plot([r["vertices"] for r in own], [r["p50_ms"] for r in own], marker="o", label=f"{TITLES[viewer]}: median")
        left.fill_between([r["vertices"] for r in own], [r["least_ms"] for r in own], [r["p90_ms"] or r["p50_ms"] for r in own],
                          alpha=0.25)
    left.axhspan(*PAPER_REMOTE_MS, alpha=0.25, color="grey", label="the paper, remote on a LAN")
    left.axhline(PAPER_LOCAL_MS, color="grey", linestyle="--", linewidth=1, label="the paper, local")
    left.set_yscale("log")
    left.set_xlabel("vertices rebuilt")
    left.set_ylabel("pose to rebuilt surface, ms (least to 90 %)")
    left.grid(alpha=0.3)
    left.legend(fontsize=7)
    for axis_shift, viewer in ((-0.2, "local"), (0.2, "picture")):
        own = [row for row in rows if row["viewer"] == viewer]
        bottom = [0.0] * len(own)
        positions = [i + axis_shift for i in range(len(own))]
        for number, (part, members) in enumerate(PARTS.items()):
            heights = [sum(r[f"{m}_p50_ms"] or 0 for m in members) for r in own]
            right.bar(positions, heights, 0.36, bottom=bottom, color=f"C{number}", label=part if viewer == "picture" else None)
            bottom = [b + h for b, h in zip(bottom, heights)]
        for x, height in zip(positions, bottom):
            right.text(x, height, f"{height:.2g}", ha="center", va="bottom", fontsize=7)
        right.set_xticks(range(len(own)), [f"{r['vertices']:.0f}" for r in own])
    right.set_yscale("symlog", linthresh=1)
    right.set_ylim(0, 1000)
    right.set_xlabel("vertices rebuilt")
    right.set_ylabel(f"medians of the stages, ms: to the surface, to a picture of {PICTURE}", fontsize=8)
    right.legend(fontsize=7, ncol=2, loc="upper left")
    figure.suptitle("Figure 11: delay per level of detail: heart, r = 200, 30 poses/s, raw")
    write_picture(options, "figure_11", figure)


def main():
    p = parser(__doc__)
    p.add_argument("--seconds", type=float, default=4, help="of each run")
    p.add_argument("--viewers", nargs="*", default=list(VIEWERS), choices=list(VIEWERS))
    options = p.parse_args()
    rows = [row for row in earlier_rows(options) if row["viewer"] not in options.viewers]
    with Stage(options) as stage:
        rows += [row_of(viewer, level, measure(options, stage, viewer, level)) for viewer in options.viewers for level in LEVELS]
    rows.sort(key=lambda row: (list(VIEWERS).index(row["viewer"]), row["level"]))
    write_table(options, "figure_11", HEADER, [["" if row[name] is None else row[name] for name in HEADER] for row in rows])
    draw(options, rows)


if __name__ == "__main__":
    main()
