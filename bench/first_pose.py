#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""How long a surface that was never baked takes to its first pose on the wire, and what learning columns costs its sender.

    first_pose.py --bin FOLDER [--vertices N]... [--seconds SECONDS]

For each number of vertices (default: 50,000 and 300,000) a line. `pipe` gets a torus that sways and folds, 30 poses a second.
First pose: from the start of the program, reading the mesh included, to the broker's first frame, nothing cached; whole basis: to
the end of the bake. Learning (`--learn on` against `off`, baked before, so many seconds each): processor time that it takes, in
percent of a core over those seconds and in all, and the most memory of the sender, without and with it.
"""
import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request

from large_bake import np, processor_seconds, resident_gb, write_ply

RATE, LOOP = 30, 37  # Poses.


def torus(vertices):
    rings = round((vertices / 2) ** 0.5)
    i, j = (part.reshape(-1) for part in np.meshgrid(np.arange(2 * rings), np.arange(rings), indexing="ij"))
    corner = lambda a, b: (i + a) % (2 * rings) * rings + (j + b) % rings
    faces = np.concatenate([np.stack([corner(0, 0), corner(1, 0), corner(1, 1)], 1), np.stack([corner(0, 0), corner(1, 1), corner(0, 1)], 1)])
    return np.pi * i / rings, 2 * np.pi * j / rings, faces


def pose(along, around, t):
    radius = 0.3 + 0.02 * np.sin(t) * np.sin(60 * along) + 0.02 * np.cos(1.7 * t) * np.sin(45 * along)
    turn = along + 0.2 * np.sin(2 * along + t)
    ring = 1 + radius * np.cos(around)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), radius * np.sin(around) + 0.3 * np.sin(0.7 * t) * np.cos(along)], 1).astype("<f4")


class Broker:
    def __init__(self, options, folder):
        ports = folder / "port"
        ports.unlink(missing_ok=True)
        self.process = subprocess.Popen([options.bin / "eigencast-broker", "--listen=127.0.0.1:0", "--admin-listen=127.0.0.1:0", f"--port-file={ports}",
                                         f"--data-dir={folder / 'broker'}", "--log-level=error"])
        while not (ports.exists() and ports.read_text().count("\n") == 2):
            time.sleep(0.01)
        self.port, self.admin = ports.read_text().split()

    def has_frames(self):
        with urllib.request.urlopen(f"http://127.0.0.1:{self.admin}/metrics") as answer:
            return "\neigencast_broker_frames_received_total 0\n" not in answer.read().decode()

    def end(self):
        self.process.terminate()
        self.process.wait()


class Sender:
    """Fed until end()."""

    def __init__(self, options, folder, broker, poses, *more):
        self.report, self.over = folder / "report.json", threading.Event()
        self.begun = time.monotonic()
        self.process = subprocess.Popen([options.bin / "eigencast-sender", "--no-progress", "pipe", "--mesh", folder / "torus.ply", "--to",
                                         f"http://127.0.0.1:{broker.port}/torus", "--rank", "200", "--rate", str(RATE), "--memory", "off", "--cache",
                                         folder / "bakes", "--json", self.report, *more], stdin=subprocess.PIPE, stderr=open(folder / "log", "w"))
        self.feeder = threading.Thread(target=self.feed, args=(poses,))
        self.feeder.start()

    def feed(self, poses):
        number = 0
        while not self.over.is_set():
            self.process.stdin.write(poses[number % len(poses)])
            number += 1
        self.process.stdin.close()

    def wait(self, condition):
        """Seconds since it started."""
        while not condition():
            if self.process.poll() is not None:
                sys.exit(f"the sender ended with {self.process.returncode}")
            time.sleep(0.01)
        return time.monotonic() - self.begun

    def end(self):
        self.over.set()
        self.feeder.join()
        if self.process.wait() != 0:
            sys.exit(f"the sender ended with {self.process.returncode}")
        return json.loads(self.report.read_text())


def first_pose(options, folder, poses):
    broker = Broker(options, folder)
    sender = Sender(options, folder, broker, poses)
    first = sender.wait(broker.has_frames)
    whole = sender.wait(lambda: "all of the basis is there: r =" in (folder / "log").read_text())
    sender.end()
    broker.end()
    return first, whole


def learning(options, folder, poses, use):
    """Processor seconds and most memory of a sender of so many seconds, and its report."""
    broker = Broker(options, folder)
    sender = Sender(options, folder, broker, poses, "--wait", "--learn", use)
    begun = sender.wait(broker.has_frames)
    used, most = processor_seconds(sender.process.pid), 0
    while time.monotonic() - sender.begun < begun + options.seconds:
        most = max(most, resident_gb(sender.process.pid))
        time.sleep(0.05)
    used = processor_seconds(sender.process.pid) - used
    report = sender.end()
    broker.end()
    return used, most, report


def main():
    p = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    p.add_argument("--bin", type=pathlib.Path, required=True, help="folder of the programs, built with preset bench or release")
    p.add_argument("--vertices", type=int, action="append", help="may be given several times")
    p.add_argument("--seconds", type=float, default=20)
    options = p.parse_args()
    for wanted in options.vertices or [50_000, 300_000]:
        with tempfile.TemporaryDirectory(prefix="eigencast-first-") as name:
            folder = pathlib.Path(name)
            along, around, faces = torus(wanted)
            poses = [pose(along, around, 0.2 * number).tobytes() for number in range(LOOP)]
            write_ply(folder / "torus.ply", pose(along, around, 0), faces)
            first, whole = first_pose(options, folder, poses)
            print(f"{len(along)} vertices: first pose after {first:.2f} s, whole basis after {whole:.2f} s", end="", flush=True)
            (plain_s, plain_gb, _), (used_s, most_gb, report) = (learning(options, folder, poses, use) for use in ("off", "on"))
            more = used_s - plain_s
            print(f"; {report['learnt_columns']} columns of {report['learnt_bytes'] / 1000:.0f} kB learnt in {report['changes']} change: "
                  f"{more:.2f} s of processor in {options.seconds:.0f} s, {100 * more / options.seconds:.1f} % of a core; most memory "
                  f"{1000 * plain_gb:.0f} and {1000 * most_gb:.0f} MB", flush=True)


if __name__ == "__main__":
    main()
