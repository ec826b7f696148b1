#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Bakes every surface below a folder and writes a table: baked how well and how fast, or refused why.

    bake_all.py SENDER FOLDER [--rank R] [--points] [--only TEXT]

SENDER is the eigencast-sender to use, of any build: with one of the asan preset this is the same run under
AddressSanitizer and UBSan. A vertices.npy stands for its clip and its rest.obj is not baked again; --points bakes the
clips a second time without their faces, as clouds. Fails when a bake crashes, hangs, gives no reason for a refusal, or
does not rebuild the rest pose to 1e-4 of the diagonal. Standard library only.
"""
import argparse
import json
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import time

ENDINGS = {".obj", ".off", ".ply", ".stl", ".xyz", ".glb", ".gltf", ".npy"}
TIMEOUT_S = 600
COLUMNS = ("file", "vertices", "faces", "oddities", "r", "residual", "rest error", "MB", "s", "peak MB", "result")


def inputs(folder):
    for path in sorted(folder.rglob("*")):
        if path.suffix not in ENDINGS or path.name == "faces.npy":
            continue
        if path.suffix == ".obj" and (path.parent / "vertices.npy").exists():
            continue
        yield path


def points_of(path, folder):
    """The rest pose of a clip as x y z lines."""
    lines = [line[2:] for line in (path.parent / "rest.obj").read_text().splitlines() if line.startswith("v ")]
    cloud = pathlib.Path(folder) / f"{path.parent.name}.xyz"
    cloud.write_text("\n".join(lines) + "\n")
    return cloud


def oddities(report):
    """Lines of the report that say what is unusual about the surface, short."""
    found = []
    for line in report.splitlines():
        if line.startswith("operator:"):
            found.append(line.split(":", 1)[1].strip())
        elif re.match(r"\s*\d+ (boundary|non-manifold|duplicate|unreferenced|degenerate|faces|edges)", line):
            found.append(line.strip().split(":")[0])
    return "; ".join(found)


def run(command):
    """Exit status, standard output, last line of standard error, seconds, peak MB."""
    begin = time.monotonic()
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        child = subprocess.Popen(command, stdout=out, stderr=err)
        status = None
        while status is None:
            pid, code, usage = os.wait4(child.pid, os.WNOHANG)
            if pid != 0:
                status = os.waitstatus_to_exitcode(code)
            elif time.monotonic() - begin > TIMEOUT_S:
                child.kill()
                _, _, usage = os.wait4(child.pid, 0)
                status = "hangs"
            else:
                time.sleep(0.02)
        child.returncode = 0  # waited for
        out.seek(0)
        err.seek(0)
        said = [line for line in err.read().splitlines() if line.strip()]
        return status, out.read(), said, time.monotonic() - begin, usage.ru_maxrss / 1024


def bake(sender, path, name, rank):
    """One row of the table, and whether it is as it should be."""
    with tempfile.NamedTemporaryFile(suffix=".json") as report:
        status, text, said, seconds, peak = run([sender, "--no-progress", "bake", str(path), "--rank", str(rank),
                                                 "--cache", "", "--json", report.name])
        facts = json.loads(pathlib.Path(report.name).read_text() or "{}")
    row = dict.fromkeys(COLUMNS, "")
    row.update(file=name, s=f"{seconds:.1f}")
    row["peak MB"] = f"{peak:.0f}"
    if status == 0:
        error = re.search(r"rest pose: worst error (\S+)", text)
        row.update(vertices=facts["vertices"], faces=facts["faces"], r=facts["rank"], oddities=oddities(text))
        row["residual"] = f"{facts['residual']:.0e}"
        row["rest error"] = error[1] if error else "?"
        row["MB"] = f"{facts['bytes'] / 1e6:.2f}"
        good = bool(error) and (facts["basis"] != "augmented" or float(error[1]) < 1e-4) and (facts["certified"] or facts["approximate"])
        row["result"] = "baked" if good else "BAKED BADLY"
        return row, good
    if status == 1 and said and not any("ERROR: AddressSanitizer" in line or "runtime error" in line for line in said):
        reason = re.sub(r"^\S+ error ", "", said[-1])
        row["result"] = "refused: " + reason.replace(str(path), name)
        return row, True
    row["result"] = f"FAILED, status {status}: {said[-1] if said else 'no reason'}"
    return row, False


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sender")
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--rank", type=int, default=200)
    parser.add_argument("--points", action="store_true", help="clips without their faces, too")
    parser.add_argument("--only", default="", help="only files whose path contains this")
    options = parser.parse_args()
    print("| " + " | ".join(COLUMNS) + " |")
    print("|" + "-|" * len(COLUMNS))
    bad = 0
    with tempfile.TemporaryDirectory() as temporary:
        jobs = [(path, str(path.relative_to(options.folder))) for path in inputs(options.folder)]
        if options.points:
            clips = [path for path, _ in jobs if path.name == "vertices.npy"]
            jobs += [(points_of(path, temporary), f"{path.parent.name} as points") for path in clips]
        for path, name in jobs:
            if options.only not in name:
                continue
            row, good = bake(options.sender, path, name, options.rank)
            bad += not good
            print("| " + " | ".join(str(row[column]) for column in COLUMNS) + " |", flush=True)
    if bad:
        sys.exit(f"{bad} of {len(jobs)} are not as they should be")


if __name__ == "__main__":
    main()
