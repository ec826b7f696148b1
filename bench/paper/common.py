# SPDX-License-Identifier: MIT
"""What the scripts of this folder share: the programs, a broker of their own, clips, truth, tables and plots.

Each script regenerates one figure or table into --out (CSV and PNG). It stops with words and status 77 where an input is
absent, so that a run of all of them shows what was left out.
"""
import argparse
import csv
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.request

ROOT = pathlib.Path(__file__).resolve().parents[2]


def skip(why):
    print(f"SKIPPED: {why}", file=sys.stderr)
    sys.exit(77)


try:
    import numpy as np
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
except ImportError as missing:
    skip(f"{missing.name} is not there: apt-get install python3-numpy python3-matplotlib, and use /usr/bin/python3")


def parser(description):
    p = argparse.ArgumentParser(description=description)
    p.add_argument("--bin", type=pathlib.Path, default=ROOT / "build/release/bin", help="folder of the programs")
    p.add_argument("--data", type=pathlib.Path, default=os.environ.get("EIGENCAST_DATA_DIR"),
                   help="folder of the real clips (default: EIGENCAST_DATA_DIR)")
    p.add_argument("--out", type=pathlib.Path, default=ROOT / "out/paper", help="folder for CSV and PNG")
    return p


def bench_parser(description):
    """For what runs programs of the preset bench."""
    p = parser(description)
    p.add_argument("--programs", type=pathlib.Path, default=ROOT / "build/bench/bench", help="folder of the preset bench's programs")
    return p


def bench_program(options, name):
    found = options.programs / name
    if not found.exists():
        skip(f"{found} is not built (cmake --preset bench; ninja {name}), or --programs names another folder")
    return found


def bench_rows(options, name, *arguments, **how):
    """What such a program prints as CSV: a dictionary for each line."""
    done = subprocess.run([bench_program(options, name), *arguments], check=True, capture_output=True, text=True, **how)
    return list(csv.DictReader(done.stdout.splitlines()))


def data_file(options, name):
    """A file of the real data, which must be there."""
    if options.data is None:
        skip(f"no folder of real clips for {name}: set EIGENCAST_DATA_DIR, or give --data")
    if not (options.data / name).exists():
        skip(f"{options.data / name} is not there")
    return options.data / name


def clip_argument(options, name):
    """The sender's argument for a clip: a built-in's name, or the folder of a real one, which must be there."""
    if name.split(":")[0] in ("heart", "sphere", "torus", "bar"):
        return name
    return str(data_file(options, f"animations/{name}/vertices.npy"))


def lines_of(path):
    """The JSON objects of a file of lines; a last line that is not whole is left out."""
    text = path.read_text()
    return [json.loads(line) for line in text[:text.rfind("\n") + 1].splitlines()]


class Stage:
    """A broker on a port of its own and what runs beside it; everything ends with the `with` block."""

    def __init__(self, options, *broker_arguments):
        self.options, self.broker_arguments = options, broker_arguments
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="eigencast-paper-"))
        self.running = []

    def program(self, name):
        found = self.options.bin / name
        if not found.exists():
            skip(f"{found} is not built (ninja {name}), or --bin names another folder")
        return str(found)

    def __enter__(self):
        port_file = self.folder / "port"
        self.start("eigencast-broker", "--listen", "127.0.0.1:0", "--admin-listen", "127.0.0.1:0", "--port-file",
                   port_file, "--data-dir", self.folder / "assets", *self.broker_arguments)
        self.port = self.port_from(port_file)
        return self

    def __exit__(self, *_):
        for process in reversed(self.running):
            process.terminate()
        for process in self.running:
            process.wait(10)
        shutil.rmtree(self.folder, ignore_errors=True)

    def start(self, name, *arguments, **popen):
        log = open(self.folder / f"{len(self.running)}-{name}.log", "w")
        process = subprocess.Popen([self.program(name), *map(str, arguments)], stdout=log, stderr=log, **popen)
        process.log = pathlib.Path(log.name)
        self.running.append(process)
        return process

    def wait(self, process, seconds):
        status = process.wait(seconds)
        if status != 0:
            sys.exit(f"{process.args[0]} ended with {status}:\n{process.log.read_text()[-2000:]}")

    def port_from(self, path, seconds=20):
        """The first port of the file, which the program last started writes once it listens."""
        end = time.monotonic() + seconds
        while not (path.exists() and path.read_text().endswith("\n")):
            if time.monotonic() > end:
                sys.exit(f"{path} was not written:\n{self.running[-1].log.read_text()[-2000:]}")
            time.sleep(0.02)
        return int(path.read_text().split()[0])

    def bake(self, clip):
        """Once, before anybody waits for its poses; it stays in the cache."""
        self.wait(self.start("eigencast-sender", "--no-progress", "bake", clip), 300)

    def wait_live(self, stream, seconds=120):
        """Until its sender has begun, which takes a busy machine longer than a viewer waits."""
        end = time.monotonic() + seconds
        while True:
            with urllib.request.urlopen(f"http://127.0.0.1:{self.port}/v1/streams") as answer:
                if any(s["stream"] == stream and s["state"] == "live" for s in json.load(answer)["streams"]):
                    return
            if time.monotonic() > end:
                sys.exit(f"nobody sends {stream}:\n{self.running[-1].log.read_text()[-2000:]}")
            time.sleep(0.05)

    def url(self, stream, port=None):
        return f"ws://127.0.0.1:{port or self.port}/{stream}"

    def relay(self, link, seed=1):
        """The port of a new link to the broker: none, wlan, wan, 3g, thin (tests/support)."""
        port_file = self.folder / f"relay-{len(self.running)}"
        self.start("eigencast-impaired-relay", "--to", self.port, "--link", link, "--seed", seed, "--port-file",
                   port_file)
        return self.port_from(port_file)


def truth_of(stage, clip, frames, velocities=False):
    """The clip's coefficients, frame by frame (F x r x 3; with velocities, per second, F x r x 6), as the programs
    themselves make and carry them uncompressed, and its surface: area and diagonal."""
    stage.bake(clip)
    received, report = stage.folder / "truth.jsonl", stage.folder / "truth.json"
    client = stage.start("eigencast-client", stage.url("truth") + "?rate=raw", "--headless", "--size", "32x32", "--lod",
                         "0.02", "--frames", 1_000_000, "--duration", 6 + 3 * frames / 30, "--wait", 60, "--record",
                         received, "--json", report)
    sent = stage.folder / "truth-sent.jsonl"
    stage.wait(stage.start("eigencast-sender", "--no-progress", "play", "--wait", clip, "--to", stage.url("truth"), "--codec",
                           "float64", "--frames", 2 * frames, "--record", sent,
                           *(["--velocities"] if velocities else [])), 300)
    stage.wait(client, 60)
    frame_at = {line["capture_us"]: line["frame"] for line in lines_of(sent)}
    poses = [None] * frames
    for line in lines_of(received):
        if line["capture_us"] in frame_at:
            pose = np.array(line["coefficients"]).reshape(-1, line["channels"])
            pose[:, 3:] *= 4 * 30  # Sent as the movement in a quarter of a key interval.
            poses[frame_at[line["capture_us"]]] = pose
    missing = sum(pose is None for pose in poses)
    if missing:
        sys.exit(f"{clip}: {missing} of {frames} frames did not come over the uncompressed stream")
    return np.array(poses), json.loads(report.read_text())["surface"]


def watch(stage, stream, query, seconds, *arguments, size="360x360", pictures=True):
    """Starts a viewer that keeps what it draws; drawn(viewer) gives that once it has ended."""
    folder = stage.folder / f"watch-{len(stage.running)}"
    folder.mkdir()
    out = ["--out", folder] if pictures else []
    viewer = stage.start("eigencast-client", stage.url(stream) + "?" + query, "--headless", "--size", size, "--duration",
                         seconds, "--wait", 60, "--record-shown", folder / "shown.jsonl", "--json",
                         folder / "report.json", *out, *arguments)
    viewer.folder = folder
    return viewer


def drawn(stage, viewer):
    """What each picture shows (capture_us, drawn_us, shown, C as r x 3, png), in order, and the viewer's report."""
    stage.wait(viewer, 120)
    lines = lines_of(viewer.folder / "shown.jsonl")
    rank = json.loads((viewer.folder / "report.json").read_text())["bands"]["rank"]
    for number, line in enumerate(lines):
        line["C"] = np.array(line.pop("coefficients")).reshape(rank, -1)[:, :3]
        line["png"] = viewer.folder / f"frame_{number + 1:04d}.png"
    return lines, json.loads((viewer.folder / "report.json").read_text())


def rms_over_diagonal(difference, surface):
    """Of a difference of coefficients, by Parseval, in percent."""
    return 100 * float(np.linalg.norm(difference)) * surface["area"] ** -0.5 / surface["diagonal"]


def strip(options, name, rows, title):
    """rows: lists of (png or None, caption), drawn as a grid of pictures."""
    columns = max(len(row) for row in rows)
    figure, axes = plt.subplots(len(rows), columns, figsize=(2.9 * columns, 3.1 * len(rows)), squeeze=False, layout="constrained")
    for row, line in zip(axes, rows):
        for axis, (png, caption) in zip(row, line + [(None, "")] * (columns - len(line))):
            axis.axis("off")
            axis.set_title(caption, fontsize=8)
            if png is not None:
                axis.imshow(plt.imread(png))
    figure.suptitle(title, fontsize=10)
    write_picture(options, name, figure)


def write_table(options, name, header, rows):
    options.out.mkdir(parents=True, exist_ok=True)
    with open(options.out / f"{name}.csv", "w", newline="") as file:
        csv.writer(file).writerows([header, *rows])
    widths = [max(len(str(row[i])) for row in [header, *rows]) for i in range(len(header))]
    for row in [header, *rows]:
        print("  ".join(str(value).ljust(width) for value, width in zip(row, widths)).rstrip())


def write_picture(options, name, figure):
    options.out.mkdir(parents=True, exist_ok=True)
    figure.savefig(options.out / f"{name}.png", dpi=110, bbox_inches="tight")
    plt.close(figure)
    print(options.out / f"{name}.png")
