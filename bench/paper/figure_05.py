#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Figure 5 of Zhang et al. 2013: time that a receiver takes to rebuild one pose, over its level of detail.

Runs reconstruction_levels (preset bench) on three clips, baked as they are streamed: as it comes, with one thread, with SSE2 only,
and with a quarter of a processor (a control group of the cpu controller; where none can be made the row is left out). The paper's
curves are of a PC of 3.07 GHz and of an iPad 2, without numbers; its transform of one frame (Table I) is drawn beside ours instead.
"""
import os

from common import bench_parser, bench_rows, clip_argument, pathlib, plt, write_picture, write_table

PAPER_MS = {"horse-gallop": 35, "elephant-gallop": 275, "heart:fine": 415}  # The last is as large as its dinosaur.
GROUP = pathlib.Path("/sys/fs/cgroup/cpu/eigencast-figure-05")
QUOTA = 0.25
WAYS = {"all threads, best instructions": ("best", 0, 0.05), "one thread": ("best", 1, 0.05), "one thread, SSE2": ("baseline", 1, 0.05),
        f"{QUOTA:.0%} of a processor": ("best", 0, 0.6)}


class Quota:
    """A control group in which processes may use a share of one processor; made() is false where that is not allowed."""

    def __enter__(self):
        try:
            GROUP.mkdir()
            period = int((GROUP / "cpu.cfs_period_us").read_text())
            (GROUP / "cpu.cfs_quota_us").write_text(str(int(period * QUOTA)))
            self.made = True
        except OSError as error:
            print(f"no row of a quota: {error}")
            self.made = False
        return self

    def enter(self):
        (GROUP / "cgroup.procs").write_text(str(os.getpid()))

    def __exit__(self, *_):
        if GROUP.exists():
            GROUP.rmdir()


def main():
    options = bench_parser(__doc__).parse_args()
    table = []
    figure, axes = plt.subplots(1, len(PAPER_MS), figsize=(13, 4.2))
    with Quota() as quota:
        for axis, (name, paper_ms) in zip(axes, PAPER_MS.items()):
            clip = clip_argument(options, name)
            for way, (instructions, threads, seconds) in WAYS.items():
                limited = "processor" in way
                if limited and not quota.made:
                    continue
                rows = bench_rows(options, "reconstruction_levels", clip, instructions, str(threads), str(seconds),
                                  preexec_fn=quota.enter if limited else None)
                column = "mean_ms" if limited else "median_ms"
                axis.plot([int(row["level_percent"]) for row in rows], [float(row[column]) for row in rows], ".-", label=way)
                vertices = int(rows[0]["vertices"])
                table.append([name, vertices, way, *(f"{float(row[column]):.3f}" for row in rows)])
            axis.axhline(paper_ms, color="gray", linestyle=":", label="the paper's transform, full detail")
            axis.set_yscale("log")
            axis.set_title(f"{name}, {vertices:,} vertices", fontsize=9)
            axis.set_xlabel("level of detail, %")
            axis.set_ylabel("ms")
            axis.grid(alpha=0.3)
            axis.legend(fontsize=7)
    write_table(options, "figure_05", ["surface", "vertices", "how", *(f"{level} %" for level in range(10, 101, 10))], table)
    figure.suptitle("Figure 5: one pose rebuilt, r = 200")
    write_picture(options, "figure_05", figure)


if __name__ == "__main__":
    main()
