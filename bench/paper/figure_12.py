#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Figure 12 of Zhang et al. 2013: the rate of poses tripled by two linear interpolations, and what it costs in delay.

Two viewers watch one sender of 10 keys a second, one takes the keys, one what the broker makes of them.
"""
from common import (Stage, clip_argument, drawn, lines_of, np, parser, plt, watch, write_picture, write_table)

CLIP = "heart"
QUERIES = {"raw": "rate=raw", "interpolated x3": "rate=interpolated&k=3"}


def main():
    p = parser(__doc__)
    p.add_argument("--seconds", type=float, default=12)
    options = p.parse_args()
    with Stage(options) as stage:
        viewers = {name: watch(stage, "heart", query, options.seconds, size="48x48", pictures=False)
                   for name, query in QUERIES.items()}
        sent = stage.folder / "sent.jsonl"
        sender = stage.start("eigencast-sender", "--no-progress", "play", "--wait", clip_argument(options, CLIP), "--rate", 10, "--to",
                             stage.url("heart"), "--record", sent)
        seen = {name: drawn(stage, viewer) for name, viewer in viewers.items()}
        sender.terminate()
        sender.wait(20)
    figure, axes = plt.subplots(2, 1, figsize=(9.5, 6), height_ratios=(2, 1))
    raw = seen["raw"][0]
    spread = np.std([picture["C"] for picture in raw], axis=0)
    row, axis_number = np.unravel_index(np.argmax(spread), spread.shape)
    begin = raw[len(raw) // 2]["drawn_us"]
    table = []
    for name, (pictures, report) in seen.items():
        steady = pictures[len(pictures) // 4:]
        times = np.array([picture["drawn_us"] for picture in steady])
        gaps = np.diff(times) / 1000
        delays = np.array([picture["drawn_us"] - picture["capture_us"] for picture in steady]) / 1000
        values = [picture["C"][row, axis_number] for picture in steady]
        axes[0].step((times - begin) / 1e6, values, where="post", label=f"{name}: {1000 / np.mean(gaps):.1f} poses/s")
        axes[1].plot((times[1:] - begin) / 1e6, gaps, ".-", markersize=3, label=name)
        table.append([name, f"{1000 / np.mean(gaps):.2f}", f"{np.percentile(gaps, 50):.1f}", f"{np.percentile(gaps, 95):.1f}",
                      f"{np.percentile(delays, 50):.1f}", f"{report['kbit_per_s']:.1f}"])
    for axis, label in zip(axes, (f"displayed coefficient {row}, {'xyz'[axis_number]}", "ms since the pose before")):
        axis.set_xlim(0, 2)
        axis.set_ylabel(label, fontsize=8)
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    axes[1].set_xlabel("s")
    figure.suptitle(f"Figure 12: {CLIP}, 10 keys/s")
    write_picture(options, "figure_12", figure)
    write_table(options, "figure_12", ["mode", "poses/s", "gap p50 ms", "gap p95 ms", "age p50 ms", "kbit/s"], table)


if __name__ == "__main__":
    main()
