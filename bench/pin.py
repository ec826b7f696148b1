#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""How near to the surface a pin is drawn that rides on it, at few vertices and at all.

    bench/pin.py BIN_DIR CLIP_DIR [--vertex N] [--pictures 8] [--out FOLDER]

CLIP_DIR has vertices.npy and faces.npy. A member of a room pins a note to a face of vertex N (default: the one that moves
most); native viewers in that room draw the clip, played as a stream, with 5 % and with all of its vertices. Prints a line
of JSON: the distance of each pin drawn from where the same point of the face is in the frame of the clip that is shown (the
nearest one: frames lie far apart), in % of the diagonal, largest and mean, and how far the point moves from frame to frame.
"""
import argparse
import json
import pathlib
import subprocess
import sys
import tempfile
import threading

import numpy

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "tests/support"))
from websocket_peer import Broker, Peer, control, next_control, stay

WEIGHTS = numpy.array([0.2, 0.3, 0.5])


def drawn(options, url, level, number, folder):
    """Where a viewer draws the pin, with a picture of it."""
    picture = folder / f"pin-{level:g}-{number}.png"
    subprocess.run([options.bin / "eigencast-client", url, "--headless", "--size", "960x540", "--rate", "raw", "--lod", str(level), "--room", "lab/pin",
                    "--name", "viewer", "--frames", str(20 + 5 * number), "--colour", "clay", "--json", folder / "report", "--screenshot", picture],
                   check=True, stderr=subprocess.DEVNULL)
    report = json.loads((folder / "report").read_text())
    (mark,) = [mark for mark in report["room"]["marks"] if mark["pin"]]
    return numpy.array(mark["at"]), report["lod"]["vertices"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bin", type=pathlib.Path)
    parser.add_argument("clip", type=pathlib.Path)
    parser.add_argument("--vertex", type=int)
    parser.add_argument("--pictures", type=int, default=8)
    parser.add_argument("--out", type=pathlib.Path)
    options = parser.parse_args()
    frames, faces = numpy.load(options.clip / "vertices.npy").astype(float), numpy.load(options.clip / "faces.npy")
    a, b, c = (frames[0][faces[:, k]] for k in range(3))
    area = numpy.linalg.norm(numpy.cross(b - a, c - a), axis=1, keepdims=True)
    frames -= (area * (a + b + c)).sum(axis=0) / (3 * area.sum())  # Where a viewer's scene has its origin.
    diagonal = numpy.linalg.norm(numpy.ptp(frames[0], axis=0))
    vertex = options.vertex if options.vertex is not None else int(numpy.ptp(frames, axis=0).sum(axis=1).argmax())
    corners = faces[(faces == vertex).any(axis=1)][0]
    true = (frames[:, corners] * WEIGHTS[:, None]).sum(axis=1)
    steps = numpy.linalg.norm(numpy.roll(true, -1, axis=0) - true, axis=1)
    result = {"vertex": vertex, "moves_a_frame_%": round(100 * float(steps.mean()) / diagonal, 3)}
    with tempfile.TemporaryDirectory() as name, Broker(options.bin / "eigencast-broker") as broker:
        folder = options.out or pathlib.Path(name)
        folder.mkdir(exist_ok=True)
        url = f"http://127.0.0.1:{broker.port}/lab/clip"
        sender = subprocess.Popen([options.bin / "eigencast-sender", "play", options.clip, "--to", url, "--rate", "30", "--wait", "--no-progress"])
        try:
            member = Peer(broker.port, "/v1/subscribe", "eigencast.v2")
            member.send(control(op="enter", room="lab/pin", name="Ada"))
            next_control(member, "room")
            pin = {"stream": "lab/clip", "corners": corners.tolist(), "weights": WEIGHTS.tolist(), "note": "here"}
            member.send(control(op="say", room="lab/pin", keep=True, values={"pin.1": pin}))
            threading.Thread(target=stay, args=(member,), daemon=True).start()  # A room ends with its last member.
            for level in (0.05, 1):
                off, vertices = [], 0
                for number in range(options.pictures):
                    at, vertices = drawn(options, url, level, number, folder)
                    off.append(100 * float(numpy.linalg.norm(true - at, axis=1).min()) / diagonal)
                result[f"{level:.0%}"] = {"vertices": vertices, "off_%": {"mean": round(float(numpy.mean(off)), 4), "max": round(max(off), 4)}}
        finally:
            sender.terminate()
            sender.wait()
    print(json.dumps(result))


if __name__ == "__main__":
    main()
