#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""An example in its host: a viewer that is there first receives its poses, in order; with --picture all of them.

Usage: examples_test.py BROKER LIBRARY PACKAGE_FOLDER [--picture CLIENT FILE.png] COMMAND...
COMMAND gets the stream's URL and says how many poses it sent. Once a viewer has the first, there is a file `seen` in its folder. Exits with
77 where numpy is missing.
"""
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import time

try:
    import numpy
except ImportError:
    print("SKIPPED: numpy is not installed for this interpreter")
    sys.exit(77)

BROKER, os.environ["EIGENCAST_LIBRARY"], PACKAGE, *COMMAND = sys.argv[1:]
CLIENT = PICTURE = None
if COMMAND[0] == "--picture":
    CLIENT, PICTURE, *COMMAND = COMMAND[1:]
sys.dont_write_bytecode = True
sys.path.insert(0, PACKAGE)
import eigencast  # noqa: E402


def main():
    with tempfile.TemporaryDirectory(prefix="eigencast-examples-") as name:
        folder = pathlib.Path(name)
        port = folder / "port"
        environment = dict(os.environ, EIGENCAST_CACHE=str(folder / "cache"), PYTHONPATH=PACKAGE + os.pathsep + os.environ.get("PYTHONPATH", ""),
                           PYTHONDONTWRITEBYTECODE="1", PATH=os.path.dirname(BROKER) + os.pathsep + os.environ["PATH"])
        broker = subprocess.Popen([BROKER, "--listen", "127.0.0.1:0", "--admin-listen", "127.0.0.1:0", "--port-file", port, "--data-dir",
                                   folder / "assets"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            end = time.monotonic() + 60
            while not port.exists() or not port.read_text().endswith("\n"):
                if time.monotonic() > end:
                    sys.exit("the broker did not start")
                time.sleep(0.02)
            watch(f"http://127.0.0.1:{port.read_text().split()[0]}/example", environment, folder)
        finally:
            broker.terminate()
            broker.wait()


def watch(url, environment, folder):
    with eigencast.Subscriber(url + "?rate=raw", cache_dir="") as viewer:
        program = subprocess.Popen([*COMMAND, url], env=environment, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        artist = None
        if CLIENT:
            artist = subprocess.Popen([CLIENT, url, "--headless", "--frames", "80", "--out", folder / "pictures", "--size", "400x260"])
        sequences, moved, first, ended = [], 0.0, None, None
        while ended is None or time.monotonic() < ended + 1:
            pose = viewer.next(timeout=0.05)
            if pose is not None:
                sequences.append(pose.sequence)
                (folder / "seen").touch()
                assert numpy.isfinite(pose.positions).all()
                whole = len(pose.positions) == len(numpy.unique(pose.source_vertex)) == pose.source_vertex.max() + 1
                if whole and (first is None or len(first) != len(pose.positions)):
                    first = pose.in_source_order()
                elif whole:
                    moved = max(moved, float(numpy.abs(pose.in_source_order() - first).max()))
            elif ended is None and program.poll() is not None:
                ended = time.monotonic()
        said, stats = program.communicate()[0], viewer.stats()
    sent = next(reversed([*re.finditer(r"sent (\d+)\b", said)]), None)
    if program.returncode != 0 or not sent:
        sys.exit(f"it ended with {program.returncode}: {said}")
    print(f"sent {sent[1]} poses; a viewer received {stats.keys}, missed {stats.missed}, rebuilt {len(sequences)}; moved by {moved:.3g}")
    # The newest wins on a starved machine; the run that takes figures and a picture has the machine alone.
    least = int(sent[1]) if CLIENT else int(sent[1]) // 2
    assert int(sent[1]) > 30 and least <= stats.keys <= int(sent[1]), "all of them"
    # A join that is finer than the key it repeats is shown, too.
    assert sequences == sorted(sequences), "in order"
    assert sequences[-1] - sequences[0] < int(sent[1]), "none but its own"
    assert moved > 0.01, "and they move"
    if artist:
        artist.wait()
        pathlib.Path(PICTURE).write_bytes(sorted((folder / "pictures").glob("*.png"))[-1].read_bytes())


main()
