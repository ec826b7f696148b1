#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Whether the checker finds the faults planted in a copy of the broker: planted/*.patch, each of which acts where $PLANTED names it.

    planted_test.py SOURCES --patches                          they apply: the sources that they were made for are still there
    planted_test.py SOURCES BUILD PROGRAMS [checker's flags]   builds such a broker, and runs the checker on each fault and on none
"""
import concurrent.futures
import json
import os
import pathlib
import shutil
import subprocess
import sys

HERE = pathlib.Path(__file__).parent
SKIPPED = 77
SEED = 17
# Patch -> (codes of history.py, one of which the checker must find; what the nemesis does).
PLANTED = {
    "reordered": ({"stale", "undecodable"}, ["--only=reload-broker", "--seconds=5"]),
    "epoch-kept": ({"epoch-twice", "foreign"}, ["--only=kill-sender,move-sender", "--seconds=12"]),
    "foreign-join": ({"foreign", "other-pose"}, ["--only=hold-backbone", "--seconds=12"]),
    "subscriber-forgotten": ({"stalled"}, ["--only=hold-backbone", "--seconds=15", "--every=3", "--recovery=30"]),
    "recording-torn": ({"recording"}, ["--only=kill-broker", "--seconds=8"]),
}
CONTROL = ["--only=reload-broker,kill-sender,move-sender,hold-backbone,kill-broker", "--seconds=20"]
# What the broker is made of.
PARTS = ["cmake", "common", "sdk", "web", "broker", "sender", "tools", "deploy", "docs"]


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


def copy_changed(source, copy):
    was = pathlib.Path(copy)
    now = os.stat(source)
    if not was.exists() or (was.stat().st_mtime_ns, was.stat().st_size) != (now.st_mtime_ns, now.st_size):
        shutil.copy2(source, copy)


def built(sources, folder):
    """A broker with all of the faults; what an earlier run built is used."""
    copy, build = folder / "sources", folder / "build"
    for part in PARTS:
        shutil.copytree(sources / part, copy / part, ignore=shutil.ignore_patterns("node_modules"),  # Without them there is no page to build.
                        copy_function=copy_changed, dirs_exist_ok=True)
    for file in sources.glob("*"):
        if file.is_file():
            copy_changed(file, copy / file.name)
    for name in PLANTED:
        applied = patch(copy, name)
        assert applied.returncode == 0, applied.stdout
    jobs = os.environ.get("CMAKE_BUILD_PARALLEL_LEVEL", "2")
    for command in (["cmake", "--preset", "dev", "-B", build, "-DCMAKE_CXX_FLAGS=-O1", "-DEIGENCAST_BUILD_TESTS=OFF",
                     "-DEIGENCAST_BUILD_CLIENT=OFF"],
                    ["cmake", "--build", build, "-j", jobs, "--target", "eigencast-broker"]):
        ran = subprocess.run(command, cwd=copy, capture_output=True, text=True)
        assert ran.returncode == 0, ran.stdout[-5000:] + ran.stderr[-5000:]
    return build / "bin/eigencast-broker"


def checked(name, flags):
    """Exit status and codes of the violations."""
    ran = subprocess.run([sys.executable, HERE / "checker.py", *flags, f"--seed={SEED}"], capture_output=True, text=True,
                         env={**os.environ, "PLANTED": name})
    found = {code for line in ran.stdout.splitlines() if line.startswith("{") for code in json.loads(line)["codes"]}
    print(f"{ran.stdout[-6000:]}{ran.stderr[-3000:]}\n{name}: status {ran.returncode}, {sorted(found)}", flush=True)
    return ran.returncode, found


def main():
    sources = pathlib.Path(sys.argv[1]).resolve()
    if sys.argv[2] == "--patches":
        return check_patches(sources)
    folder, programs, flags = pathlib.Path(sys.argv[2]).resolve(), sys.argv[3], sys.argv[4:]
    flags = [programs, "--broker", built(sources, folder), *flags]
    with concurrent.futures.ThreadPoolExecutor(2) as two:
        control = two.submit(checked, "none", flags + CONTROL)
        runs = {name: two.submit(checked, name, flags + how) for name, (_, how) in PLANTED.items()}
    status, found = control.result()
    if status == SKIPPED:
        print("SKIPPED: the checker cannot run here")
        return SKIPPED
    failed = [f"{sorted(found)}, status {status}, in a broker without a fault"] if status != 0 else []
    for name, run in runs.items():
        status, found = run.result()
        if status != 1 or not found & PLANTED[name][0]:
            failed.append(f"{name}: none of {sorted(PLANTED[name][0])} is found, but {sorted(found)}, status {status}")
    print("\n".join(failed) or f"all {len(PLANTED)} are found, and nothing without them")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
