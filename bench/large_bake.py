#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Bakes a surface of a million vertices and says what it costs: large_bake.py --bin FOLDER MESH [--vertices 1000000]

MESH (.npy of positions with faces.npy beside it, or .obj) is subdivided, each triangle in four with new vertices moved as
Loop's scheme has them, until it has at least --vertices; then `eigencast-sender bake` runs on it. Prints its stages with the
seconds that each took, its report, and the time, processor time and most memory of the whole program.
"""
import argparse
import os
import pathlib
import pty
import re
import resource
import subprocess
import sys
import tempfile
import time

try:
    import numpy as np
except ImportError:
    print("SKIPPED: numpy is not there: apt-get install python3-numpy, and use /usr/bin/python3", file=sys.stderr)
    sys.exit(77)


def read_mesh(path):
    if path.suffix == ".npy":
        positions = np.load(path)
        return (positions[0] if positions.ndim == 3 else positions).astype(float), np.load(path.parent / "faces.npy")
    positions, faces = [], []
    for line in path.read_text().splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            positions.append([float(word) for word in words[1:4]])
        elif words[:1] == ["f"]:
            corners = [int(word.split("/")[0]) - 1 for word in words[1:]]
            faces += [[corners[0], b, c] for b, c in zip(corners[1:], corners[2:])]
    return np.array(positions), np.array(faces)


def subdivided(positions, faces):
    """One step of Loop's scheme; boundary edges are halved, old vertices of the boundary stay."""
    n = len(positions)
    edges = np.sort(faces[:, [1, 2, 2, 0, 0, 1]].reshape(-1, 2), axis=1)  # opposite to corners 0, 1, 2
    unique, edge_of = np.unique(edges, axis=0, return_inverse=True)
    edge_of = edge_of.reshape(-1)
    uses = np.bincount(edge_of, minlength=len(unique))
    opposite = np.zeros((len(unique), 3))
    np.add.at(opposite, edge_of, positions[faces.reshape(-1)])
    ends = positions[unique[:, 0]] + positions[unique[:, 1]]
    inner = (uses == 2)[:, None]
    middle = np.where(inner, 3 / 8 * ends + opposite / 8, ends / 2)
    valence = np.bincount(unique.reshape(-1), minlength=n)
    around = np.zeros((n, 3))
    np.add.at(around, unique[:, 0], positions[unique[:, 1]])
    np.add.at(around, unique[:, 1], positions[unique[:, 0]])
    weight = (5 / 8 - (3 / 8 + np.cos(2 * np.pi / np.maximum(valence, 1)) / 4) ** 2) / np.maximum(valence, 1)
    weight[unique[uses != 2].reshape(-1)] = 0
    old = positions * (1 - valence * weight)[:, None] + around * weight[:, None]
    a, b, c = faces.T
    ab, bc, ca = (n + edge_of.reshape(-1, 3)[:, k] for k in (2, 0, 1))
    split = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
    return np.concatenate([old, middle]), split


def write_ply(path, positions, faces):
    with open(path, "wb") as file:
        file.write(f"ply\nformat binary_little_endian 1.0\nelement vertex {len(positions)}\nproperty float x\nproperty float y\n"
                   f"property float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n".encode())
        positions.astype("<f4").tofile(file)
        rows = np.zeros(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
        rows["count"], rows["corners"] = 3, faces
        rows.tofile(file)


def processor_seconds(pid):
    words = pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def resident_gb(pid):
    return int(pathlib.Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e9


def watch_stages(pid, terminal):
    """Prints each stage when it ends: seconds, processor seconds, and the most memory seen at its progress."""
    stage, since, used, most = "reading", time.monotonic(), 0.0, 0.0
    text = b""
    while True:
        try:
            more = os.read(terminal, 4096)
        except OSError:
            more = b""
        text += more
        *lines, text = re.split(rb"[\r\n]", text) if more else (text, b"")
        for line in lines:
            name = re.match(r"\s*(?:\x1b\[[0-9;]*[A-Za-z])*([a-z][a-z, ]*[a-z])", line.decode(errors="replace"))
            if name is None or name[1] == stage:
                most = max(most, resident_gb(pid))
                continue
            now, most = processor_seconds(pid), max(most, resident_gb(pid))
            print(f"  {time.monotonic() - since:7.1f} s  {now - used:7.1f} s of processor  {most:5.2f} GB  {stage}", flush=True)
            stage, since, used, most = name[1], time.monotonic(), now, 0.0
        if not more:
            return


def main():
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("mesh", type=pathlib.Path)
    p.add_argument("--bin", type=pathlib.Path, required=True, help="folder of the programs, built with preset bench or release")
    p.add_argument("--vertices", type=int, default=1_000_000)
    p.add_argument("--rank", type=int, default=200)
    options = p.parse_args()
    positions, faces = read_mesh(options.mesh)
    while len(positions) < options.vertices:
        positions, faces = subdivided(positions, faces)
    with tempfile.TemporaryDirectory(prefix="eigencast-large-") as folder:
        mesh = pathlib.Path(folder) / "large.ply"
        write_ply(mesh, positions, faces)
        count = len(positions)
        del positions, faces
        begin = time.monotonic()
        out = open(pathlib.Path(folder) / "out", "w+")
        terminal, child_side = pty.openpty()  # progress is for terminals
        process = subprocess.Popen([options.bin / "eigencast-sender", "bake", mesh, "--rank", str(options.rank), "--cache", ""],
                                   stdout=out, stderr=child_side)
        os.close(child_side)
        watch_stages(process.pid, terminal)
        process.wait()
        seconds = time.monotonic() - begin
        out.seek(0)
        print(out.read())
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(f"{count} vertices, rank {options.rank}: {seconds:.1f} s, processor {used.ru_utime:.1f} s + {used.ru_stime:.1f} s, "
          f"most memory {used.ru_maxrss / 1e6 * 1.024:.2f} GB, status {process.returncode}")
    sys.exit(process.returncode)


if __name__ == "__main__":
    main()
