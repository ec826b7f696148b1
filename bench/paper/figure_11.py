#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Figure 11 of the paper again: the delay from pose to surface, local and remote, over the level of detail, heart model.

Each point is a run of eigencast-latency on one clock: sender, broker and viewer on this machine, the remote viewer behind a relay that
behaves like the link named. One more row goes through to the picture, drawn off the screen. The paper has 40-45 ms for remote users on
a LAN. Usage: figure_11.py [--bin build/release/bin] [--out out/paper]; takes two minutes.
"""
import json
import subprocess

import common

LEVELS = (0.1, 0.25, 0.5, 0.75, 1.0)
LINKS = (("local", None), ("remote, 20 ± 5 ms", "wlan"), ("remote, 2 Mbit/s, 100 ms", "3g"))
PICTURE = "480x360"
PAPER_MS = (40, 45)
PARTS = (("sender: transform and encode", ("schedule", "transform", "encode")),
         ("network", ("to_broker", "to_client")),
         ("broker", ("interpolation_hold", "jitter_margin", "in_broker")),
         ("viewer: decode and hand over", ("decode", "hand_over")),
         ("reconstruct", ("reconstruct",)),
         ("picture", ("present",)))


def measure(options, stage, name, level, port, *more):
    report = stage.folder / "latency.json"
    arguments = [stage.program("eigencast-latency"), "loop", stage.url(name), "--source", "heart", "--lod", level, "--duration",
                 options.seconds, "--warmup", 1.2, "--no-progress", "--json", report, *more]
    if port:
        arguments += ["--viewer-url", stage.url(name, port)]
    done = subprocess.run([str(a) for a in arguments], capture_output=True, text=True, timeout=90)
    if done.returncode != 0:
        raise SystemExit(f"eigencast-latency ended with {done.returncode}:\n{done.stdout}\n{done.stderr}")
    return json.loads(report.read_text())


def milliseconds(histogram, percentile):
    value = histogram[f"{percentile}_us"]
    return None if value is None else round(value / 1000, 3)


def row_of(name, level, report):
    stages = report["traced"]["keys"]["stages"]
    return [name, level, report["vertices_rebuilt"], *(milliseconds(report["keys"], p) for p in ("min", "p50", "p90", "max")),
            *(milliseconds(stages[s], "p50") for _, members in PARTS for s in members)]


def draw(options, rows, reports):
    figure, (left, right) = common.plt.subplots(1, 2, figsize=(11, 4.2))
    for name, _ in LINKS:
        own = [r for r in rows if r[0] == name]
        left.errorbar([r[2] for r in own], [r[4] for r in own],
                      yerr=[[max(0, r[4] - r[3]) for r in own], [max(0, r[5] - r[4]) for r in own]], marker="o", capsize=3, label=name)
    left.axhspan(*PAPER_MS, alpha=0.2, color="grey", label="the paper, remote on a LAN")
    left.set_yscale("log")
    left.set_xlabel("vertices rebuilt")
    left.set_ylabel("pose to rebuilt surface, ms (median; least and 90 %)")
    left.legend(fontsize=8)
    bottom = [0.0] * len(LEVELS)
    names = [f"{r['vertices_rebuilt']}" for r in reports]
    for part, members in PARTS:
        heights = [sum((r["traced"]["keys"]["stages"][m]["p50_us"] or 0) for m in members) / 1000 for r in reports]
        right.bar(names, heights, bottom=bottom, label=part)
        bottom = [b + h for b, h in zip(bottom, heights)]
    right.set_xlabel("vertices rebuilt")
    right.set_ylabel(f"local, to a picture of {PICTURE}: medians of the stages, ms")
    right.set_title(reports[0]["environment"]["graphics"], fontsize=8)
    right.legend(fontsize=8)
    figure.suptitle("Delay per level of detail: heart, r = 200, 30 poses/s, raw")
    common.write_picture(options, "figure_11", figure)


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--seconds", type=float, default=3, help="of each run")
    options = parser.parse_args()
    rows, pictures = [], []
    with common.Stage(options) as stage:
        ports = {name: stage.relay(link) if link else None for name, link in LINKS}
        for i, level in enumerate(LEVELS):
            for name, _ in LINKS:
                rows.append(row_of(name, level, measure(options, stage, f"paper/{i}", level, ports[name])))
            pictures.append(measure(options, stage, f"paper/{i}", level, None, "--present", PICTURE))
            rows.append(row_of(f"local, to a picture of {PICTURE}", level, pictures[-1]))
    header = ["viewer", "level", "vertices", "least_ms", "p50_ms", "p90_ms", "max_ms",
              *(f"{s}_p50_ms" for _, members in PARTS for s in members)]
    common.write_table(options, "figure_11", header, rows)
    draw(options, rows, pictures)


if __name__ == "__main__":
    main()
