#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Figures 6 and 7 of Zhang et al. 2013: six galloping horses that a camera flies around fast, levels of detail and frame
rate over time, at full detail, with the paper's resolver and with the client's own.

No broker: what is measured is a picture's whole making (reconstruction, normals, upload, drawing) with the client's renderer.
Without the real horse, six built-in hearts.
"""
import csv
import io
import json
import math
import subprocess
import tempfile

from common import bench_parser, bench_program, clip_argument, np, pathlib, plt, write_picture, write_table

CHANGES = {"change_mean": "levels change", "change_part": "pixels by > 3", "motion_mean": "motion changes", "motion_part": "pixels by > 3 "}
RESOLVERS = {"none": "full detail", "paper": "Eq. 5/6, Algorithm 1", "budget": "budget (ours)"}


def flight(seconds):
    """Around the herd in 5 s a turn, near and far again every 4 s; surfaces are one unit from corner to corner."""
    keys = []
    for i in range(int(seconds / 0.25) + 1):
        t = 0.25 * i
        turn, swing = 2 * math.pi * t / 5, 0.5 - 0.5 * math.cos(2 * math.pi * t / 4)
        distance = 1.9 + 3.6 * swing
        keys.append({"t": t, "eye": [distance * math.sin(turn), 0.45 + 0.5 * swing, distance * math.cos(turn)],
                     "target": [0.5 * math.sin(1.3 * turn), 0, 0.2 * math.cos(turn)]})
    return {"keys": keys}


def fly(options, clip, path, resolver, *arguments):
    done = subprocess.run([bench_program(options, "resolution_flight"), "--clip", clip, "--flight", path, "--resolver", resolver, "--f0", str(options.f0), "--width",
                           str(options.width), "--height", str(options.height), "--cache", path.parent, *(["--model"] if options.model else []), *map(str, arguments)],
                          capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SystemExit(done.stderr)
    print(done.stderr.strip())
    rows = list(csv.DictReader(io.StringIO(done.stdout)))
    return {name: np.array([float(row[name] or "nan") for row in rows]) for name in rows[0]}


def similarity(run, since, until):
    """Of the pictures between, seconds; the paper's resolver needs its time to arrive at the rate."""
    return f"{np.nanmean(run['similarity'][(run['t_s'] >= since) & (run['t_s'] < until)]):.5f}" if run else "-"


def changed(run, what):
    """What levels alone change from picture to picture, and what everything else does: mean of all channels, of 255."""
    return f"{np.nanmean(run[what][run['t_s'] >= 1]):.4g}" if run else "-"


def row_of(name, run, similar, options):
    steady = run["t_s"] >= 1
    work, mean = run["work_ms"][steady], run["mean_lod"][steady]
    budget = 1000 / options.f0
    below = mean < 0.999
    used = work[below] / budget
    lod = np.array([run[key][steady] for key in run if key.startswith("lod_")])
    return [RESOLVERS[name], len(work), f"{1000 / np.mean(work):.1f}", f"{1000 / np.percentile(work, 95):.1f}",
            f"{100 * np.mean(work <= 1.25 * budget):.1f}",
            f"{100 * np.mean(used):.0f}" if below.any() else "-", f"{100 * np.percentile(used, 5):.0f}" if below.any() else "-",
            f"{np.mean(mean):.3f}", f"{lod.min():.3f}", similarity(similar, 1, options.seconds / 2), similarity(similar, options.seconds / 2, options.seconds + 1),
            *(changed(similar, what) for what in CHANGES if options.model)]


def main():
    p = bench_parser(__doc__)
    p.add_argument("--f0", type=float, default=20)
    p.add_argument("--seconds", type=float, default=12)
    p.add_argument("--width", type=int, default=192, help="small, where the processor draws: pixels are a fixed cost")
    p.add_argument("--height", type=int, default=108)
    p.add_argument("--count", type=int, default=6)
    p.add_argument("--clip", default="horse-gallop", help="a real clip, or a built-in shape")
    p.add_argument("--runs", type=int, default=1, help="of each resolver, interleaved; the middle one is drawn")
    p.add_argument("--model", action="store_true", help="times of a model instead of this machine's: every run is the same")
    options = p.parse_args()
    clip = options.clip
    if clip != "heart" and not (options.data and (options.data / "animations" / clip / "vertices.npy").exists()):
        print(f"{clip} is not there: built-in hearts instead")
        clip = "heart"
    with tempfile.TemporaryDirectory(prefix="eigencast-flight-") as folder:
        path = pathlib.Path(folder) / "flight.json"
        path.write_text(json.dumps(flight(options.seconds)))
        argument = clip_argument(options, clip)
        runs = {name: [] for name in RESOLVERS}
        for _ in range(options.runs):
            for name in RESOLVERS:
                runs[name].append(fly(options, argument, path, name, "--count", options.count))
        # Apart, so that the pictures to compare with disturb no time.
        similar = {name: fly(options, argument, path, name, "--count", options.count, "--compare-every", 5,
                             *(["--changes-every", 2] if options.model else []))
                   for name in RESOLVERS if name != "none"}
    header = ["levels", "pictures", "rate/s", "rate p5 /s", "within 1.25/f0 %", "budget used %", "used p5 %", "mean LOD", "least LOD",
              "SSIM to full, first half", "second half", *(CHANGES.values() if options.model else [])]
    table = [row_of(name, run, similar.get(name), options) for name in RESOLVERS for run in runs[name]]
    write_table(options, "figure_6_7", header, table)
    figure, axes = plt.subplots(2, 3, figsize=(14, 6), sharex=True, sharey="row")
    for column, name in enumerate(RESOLVERS):
        run = sorted(runs[name], key=lambda r: np.mean(r["work_ms"]))[options.runs // 2]
        for key in (k for k in run if k.startswith("lod_")):
            axes[0][column].plot(run["t_s"], run[key], linewidth=0.9, label=key.replace("lod_", "surface "))
        axes[0][column].set_title(RESOLVERS[name], fontsize=9)
        axes[1][column].plot(run["t_s"], 1000 / run["work_ms"], linewidth=0.8)
        axes[1][column].axhline(options.f0, color="grey", linestyle="--", linewidth=0.8)
        axes[1][column].set_xlabel("s")
        with open(options.out / f"figure_6_7_{name}.csv", "w", newline="") as file:
            csv.writer(file).writerows([list(run), *zip(*run.values())])
    axes[0][0].set_ylabel("level of detail (part of the vertices)")
    axes[1][0].set_ylabel("pictures a second")
    axes[1][0].set_ylim(0, 3 * options.f0)
    axes[0][2].legend(fontsize=7)
    for axis in axes.flat:
        axis.grid(alpha=0.3)
    figure.suptitle(f"Figures 6 and 7: {options.count} x {clip}, {options.width}x{options.height}, wanted {options.f0:g}/s", fontsize=10)
    write_picture(options, "figure_6_7", figure)


if __name__ == "__main__":
    main()
