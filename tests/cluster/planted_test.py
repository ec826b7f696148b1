#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Whether the checker finds what was planted in a copy of the broker: five faults, planted/*.patch.

    planted_test.py SOURCES --patches                          they apply: the sources that they were made for are still there
    planted_test.py SOURCES BUILD PROGRAMS [checker's flags]   builds a broker with each, and sees that the checker finds it, and nothing
                                                               in one without it
"""
import json
import os
import pathlib
import shutil
import subprocess
import sys

HERE = pathlib.Path(__file__).parent
SKIPPED = 77
# Patch -> (codes of judge.py, one of which the checker must find; what befalls the cluster).
PLANTED = {
    "reordered": ({"stale", "undecodable"}, ["--only=reload-broker", "--seconds=5"]),
    "epoch-kept": ({"epoch-twice", "foreign"}, ["--only=kill-sender,move-sender", "--seconds=12"]),
    "foreign-join": ({"foreign", "other-pose"}, ["--only=hold-backbone", "--seconds=12"]),
    "subscriber-forgotten": ({"still"}, ["--only=hold-backbone", "--seconds=15", "--every=3"]),
    "recording-torn": ({"recording"}, ["--only=kill-broker", "--seconds=8"]),
}
SEED = 17
# What the broker is made of.
PARTS = ["cmake", "common", "sdk", "broker", "sender", "tools", "deploy", "docs"]


def patch(sources, name, *flags):
    return subprocess.run(["patch", "-p1", "--batch", "--fuzz=0", "--no-backup-if-mismatch", *flags, "-i", HERE / "planted" / f"{name}.patch"],
                          cwd=sources, capture_output=True, text=True)


def check_patches(sources):
    assert {file.stem for file in (HERE / "planted").glob("*.patch")} == set(PLANTED)
    failed = 0
    for name in PLANTED:
        applied = patch(sources, name, "--dry-run")
        if applied.returncode != 0:
            failed = 1
            print(f"planted/{name}.patch does not apply: the code of its fault has changed; make it anew\n{applied.stdout}{applied.stderr}")
    return failed


def built(copy, build):
    for command in (["cmake", "-S", copy, "-B", build, "-G", "Ninja", "-DCMAKE_UNITY_BUILD=ON", "-DCMAKE_CXX_FLAGS=-O1 -D_GLIBCXX_ASSERTIONS",
                     "-DEIGENCAST_BUILD_TESTS=OFF", "-DEIGENCAST_BUILD_CLIENT=OFF",
                     *(["-DCMAKE_CXX_COMPILER_LAUNCHER=ccache"] if shutil.which("ccache") else [])],
                    ["cmake", "--build", build, "-j", os.environ.get("CMAKE_BUILD_PARALLEL_LEVEL", "2"), "--target", "eigencast-broker"]):
        ran = subprocess.run(command, capture_output=True, text=True)
        assert ran.returncode == 0, ran.stdout[-5000:] + ran.stderr[-5000:]
    return next(file for file in build.rglob("eigencast-broker") if file.is_file() and os.access(file, os.X_OK))


def checked(programs, broker, flags):
    """Exit status and codes of the violations."""
    ran = subprocess.run([HERE / "checker.py", programs, "--broker", broker, f"--seed={SEED}", *flags], capture_output=True, text=True)
    print(ran.stdout[-6000:] + ran.stderr[-3000:])
    found = [json.loads(line)["codes"] for line in ran.stdout.splitlines() if line.startswith("{")]
    found = set(found[0]) if found else set()
    print(f"{broker.name}: status {ran.returncode}, {sorted(found)}", flush=True)
    return ran.returncode, found


def main():
    sources = pathlib.Path(sys.argv[1]).resolve()
    if sys.argv[2] == "--patches":
        return check_patches(sources)
    build, programs, flags = pathlib.Path(sys.argv[2]).resolve(), sys.argv[3], sys.argv[4:]
    copy = build / "sources"
    for old in (copy, build / "build"):  # What an interrupted run has planted must not stay.
        shutil.rmtree(old, ignore_errors=True)
    for part in PARTS:
        shutil.copytree(sources / part, copy / part)
    for file in sources.glob("*"):
        if file.is_file():
            shutil.copy2(file, copy)
    failed = []
    clean = build / "clean"
    shutil.copy2(built(copy, build / "build"), clean)
    for name, (codes, faults) in PLANTED.items():
        status, found = checked(programs, clean, faults + flags)
        if status == SKIPPED:
            print("SKIPPED: the checker cannot run here")
            return SKIPPED
        if status != 0:
            failed.append(f"{name}: {sorted(found)} in a broker that has no such fault")
        applied = patch(copy, name)
        assert applied.returncode == 0, applied.stdout
        planted = build / name
        shutil.copy2(built(copy, build / "build"), planted)
        patch(copy, name, "-R")
        status, found = checked(programs, planted, faults + flags)
        if status != 1 or not found & codes:
            failed.append(f"{name}: none of {sorted(codes)} is found, but {sorted(found)}, status {status}")
    print("\n".join(failed) or f"all {len(PLANTED)} are found")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
