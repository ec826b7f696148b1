#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""What columns bring that a stream learns from its first seconds: new motion, and motion that comes again.

    learning.py [--bin FOLDER] [--data FOLDER] [--learn SECONDS] [--seconds SECONDS] [--mesh FILE]... [--error OVER_DIAGONAL]

For each real clip, and for a simulation of each mesh (default: the built-in heart), a line: kbit/s with headers and
KG in percent of the poses after those that it learns from, without columns, with them, and with them at as many bits;
of the second pass (real clips, 0.87 of the speed, noise 5e-4) without memory and columns, with a memory, with both;
kB of columns and manifest, seconds until they are paid back, and whether a live sender would learn. The simulation
never repeats: parts turn about joints, with sharp folds, by sums of sines without a common period. Needs numpy.
"""
import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[2]
CLIPS = ("horse-gallop", "elephant-gallop", "human-walk", "fox-run", "ict-face")
JOINTS, RATE = 12, 30


def simulated(rest, seconds, seed=1):
    """Poses x n x 3. Each joint is a plane through a vertex; what lies beyond it, and near, turns about an axis in it."""
    random = np.random.default_rng(seed)
    size = np.linalg.norm(rest.max(0) - rest.min(0))
    times = np.arange(round(seconds * RATE)) / RATE
    poses = np.repeat(rest[None], len(times), 0)
    for _ in range(JOINTS):
        pivot = rest[random.integers(len(rest))]
        axis, normal = np.linalg.qr(random.normal(size=(3, 2)))[0].T
        fold, reach = size * random.uniform(0.02, 0.05), size * random.uniform(0.15, 0.4)
        away = rest - pivot
        weights = np.exp(-(away**2).sum(1) / reach**2) / (1 + np.exp(-away @ normal / fold))
        rates, phases = random.uniform(0.2, 1.5, 3), random.uniform(0, 2 * np.pi, 3)
        angles = 0.35 * np.sin(2 * np.pi * rates * times[:, None] + phases).sum(1)
        cross = np.cross(np.eye(3), axis)
        for pose, angle in zip(poses, angles):
            turn, here = (angle * weights)[:, None], pose - pivot
            pose += np.sin(turn) * (here @ cross) + (1 - np.cos(turn)) * (here @ cross @ cross)
    return poses.astype(np.float32)


def positions_of(obj):
    with open(obj, encoding="utf-8") as lines:
        return np.array([line.split()[1:4] for line in lines if line.startswith("v ")], float)


def evaluated(options, folder, *arguments):
    report = folder / "report.json"
    command = [options.bin / "eigencast-sender", "--no-progress", "evaluate", *arguments, "--json", report]
    if options.error is not None:
        low, high = options.box
        command += ["--error", options.error * np.linalg.norm(high - low)]
    done = subprocess.run([str(word) for word in command], stdout=subprocess.DEVNULL)
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, command))} ended with {done.returncode}")
    return json.loads(report.read_text())["results"][0]["learn"]


def cell(judged, columns):
    if judged is None:
        return ["-"] * len(columns)
    return [f"{judged[c]['wire_kbit_per_s']:.1f}, {judged[c]['error']['kg_percent']:.3f}" for c in columns]


def row(name, new, again):
    trial = new.get("trial") or {}
    payback = trial.get("payback_s")
    cells = [name, *cell(new.get("rest"), ("without_columns", "with_columns", "with_columns_at_equal_bits")),
             *cell(again and again.get("again"), ("without_columns_and_memory", "with_memory", "with_columns_and_memory")),
             f"{new['columns']}: {new['side_bytes'] / 1000:.1f}; {'never' if payback is None else round(payback)}",
             "yes" if new["pays"] else "no"]
    print("| " + " | ".join(cells) + " |", flush=True)


def main():
    p = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    p.add_argument("--bin", type=pathlib.Path, default=ROOT / "build/release/bin", help="folder of the programs")
    p.add_argument("--data", type=pathlib.Path, default=os.environ.get("EIGENCAST_DATA_DIR"), help="folder of the real clips")
    p.add_argument("--learn", type=float, default=2, help="seconds that are learnt from before new motion is judged")
    p.add_argument("--seconds", type=float, default=20, help="of the simulation")
    p.add_argument("--mesh", action="append", default=[], help="OBJ file to simulate")
    p.add_argument("--error", type=float, help="vertex error that quantising may add, of the diagonal (default: 1e-3)")
    options = p.parse_args()
    print("| clip | new: plain | columns | at equal bits | again: plain | memory | and columns | columns: kB; payback, s | live |")
    print("|-|-|-|-|-|-|-|-|-|", flush=True)
    with tempfile.TemporaryDirectory(prefix="eigencast-learning-") as name:
        folder = pathlib.Path(name)
        for clip in CLIPS if options.data else ():
            path = options.data / "animations" / clip
            options.box = (lambda x: (x.min(0), x.max(0)))(positions_of(path / "rest.obj"))
            new = evaluated(options, folder, path / "vertices.npy", "--learn", options.learn)
            again = evaluated(options, folder, path / "vertices.npy", "--learn", 4, "--again", "--warp", 0.87, "--noise", 5e-4)
            row(clip, new, again)
        if not options.mesh:
            subprocess.run([options.bin / "eigencast-sender", "export", "heart", "--to", folder / "heart.npy"], check=True,
                           stdout=subprocess.DEVNULL)
        for mesh in options.mesh or [folder / "heart.obj"]:
            rest = positions_of(mesh)
            options.box = rest.min(0), rest.max(0)
            np.save(folder / "simulated.npy", simulated(rest, options.seconds))
            row(f"{pathlib.Path(mesh).stem}, simulated",
                evaluated(options, folder, folder / "simulated.npy", "--rest", mesh, "--learn", options.learn), None)


if __name__ == "__main__":
    main()
