#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""What streams take over time that remember, and learn: the built-in heart and the horse's loop, live, each with memory and without.

    memory_over_time.py [--seconds 1800] [--every 5]

kbit/s that senders send, by what predicts the keys, and kB of memory so far, read from the brokers' metrics; CSV and a plot.
"""
import time
import urllib.request

from common import Stage, clip_argument, parser, plt, write_picture, write_table

CLIPS = ("heart", "horse-gallop")
KINDS = {"memory": ("--memory", "auto"), "memory and columns": ("--memory", "auto", "--learn", "on"), "neither": ("--memory", "off")}
BYTES = 'eigencast_broker_frame_bytes_received_total{predicted_from="%s"}'


class Run(Stage):
    """A sender at a broker of its own, so that its metrics are the stream's."""

    def begin(self, clip, arguments):
        self.admin = int((self.folder / "port").read_text().split()[1])
        self.bake(clip)
        self.start("eigencast-sender", "--no-progress", "play", clip, "--wait", "--rate", 30, "--to", self.url("s"), *arguments)
        self.wait_live("s")
        self.uploaded = self.now()["eigencast_broker_upload_bytes_total"]
        return self

    def now(self):
        with urllib.request.urlopen(f"http://127.0.0.1:{self.admin}/metrics") as answer:
            lines = [line.rsplit(" ", 1) for line in answer.read().decode().splitlines() if not line.startswith("#")]
        return {name: float(value) for name, value in lines}


def main():
    p = parser(__doc__)
    p.add_argument("--seconds", type=float, default=1800)
    p.add_argument("--every", type=float, default=5, help="seconds from one reading to the next")
    options = p.parse_args()
    stages = {(clip, kind): Run(options) for clip in CLIPS for kind in KINDS}
    rows = []
    try:
        runs = {key: stage.__enter__().begin(clip_argument(options, key[0]), KINDS[key[1]]) for key, stage in stages.items()}
        begun = time.monotonic()
        last = {key: (begun, run.now()) for key, run in runs.items()}
        while (elapsed := time.monotonic() - begun) < options.seconds:
            time.sleep(options.every)
            for key, run in runs.items():
                (before_s, before), now_s, now = last[key], time.monotonic(), run.now()
                last[key] = now_s, now
                rate = lambda of: (now[BYTES % of] - before[BYTES % of]) * 8e-3 / (now_s - before_s)
                rows.append([*key, round(elapsed + options.every, 1), round(rate("keys"), 2), round(rate("memory"), 2),
                             round((now["eigencast_broker_upload_bytes_total"] - run.uploaded) / 1000, 1)])
    finally:
        for stage in stages.values():
            stage.__exit__()
    write_table(options, "memory_over_time", ["clip", "kind", "at_s", "kbit_per_s_from_keys", "kbit_per_s_from_memory", "kb_of_memory_and_columns"], rows)
    figure, axes = plt.subplots(1, len(CLIPS), figsize=(11, 4))
    for axis, clip in zip(axes, CLIPS):
        for kind in KINDS:
            mine = [row for row in rows if row[:2] == [clip, kind]]
            axis.plot([row[2] / 60 for row in mine], [row[3] + row[4] for row in mine], label=f"{kind}: {mine[-1][5]:.0f} kB beside", linewidth=0.8)
        axis.set_title(clip, fontsize=10)
        axis.set_xlabel("minutes")
        axis.set_ylabel("kbit/s of frames")
        axis.set_ylim(bottom=0)
        axis.legend(fontsize=7)
    write_picture(options, "memory_over_time", figure)


if __name__ == "__main__":
    main()
