#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""How long after the mouse a surface has followed: `eigencast-sender deform` in a window of its own (Xvfb), dragged by xdotool.

    deform_by_hand.py BUILD_DIR [MODEL...] [--rank R] [--handles FILE] [--drags N] [--repeat N]

For each model a line: from input to coefficients, to the connection, to vertices and normals in full detail, to the drawn picture, in
milliseconds: the median of the repetitions' medians and their range, the largest 99th percentile. Then what `eigencast-latency passive`
says of the same poses, which it watches as they leave: their stages up to the surface that it rebuilds. Standard library only.
"""
import argparse
import csv
import json
import os
import pathlib
import signal
import statistics
import subprocess
import tempfile
import time

STAGES = ("input_to_coefficients_us", "input_to_sent_us", "input_to_pose_us", "input_to_drawn_us")
WATCHED = ("schedule", "transform", "encode", "to_broker", "in_broker", "to_client", "decode", "hand_over", "reconstruct", "total")
# A pose that nobody's hand made, sent now and then while nothing moves, is of the moment at which it leaves.
MIN_BY_HAND_US = 5
WIDTH, HEIGHT = 640, 480


def until(condition, seconds=60):
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise SystemExit("waited in vain")
        time.sleep(0.05)


def run(build, model, rank, drags, more):
    """One session; gives the sender's report, and the stages of each pose that was watched."""
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        processes = []

        def start(command, **more):
            processes.append(subprocess.Popen(command, **more))
            return processes[-1]

        try:
            port, display = folder / "port", folder / "display"
            with open(display, "wb") as out:
                start(["Xvfb", "-displayfd", str(out.fileno()), "-screen", "0", "800x600x24", "-nolisten", "tcp"], pass_fds=[out.fileno()],
                      stderr=subprocess.DEVNULL)
            start([build / "bin/eigencast-broker", "--listen", "127.0.0.1:0", "--admin-listen", "127.0.0.1:0", "--port-file", port, "--data-dir",
                   folder / "assets"], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
            for path in (port, display):
                until(lambda path=path: path.exists() and path.read_text().endswith("\n"))
            environment = dict(os.environ, DISPLAY=":" + display.read_text().strip())
            environment.pop("WAYLAND_DISPLAY", None)
            log, report = folder / "log", folder / "report"
            with open(log, "wb") as out:
                url = f"ws://127.0.0.1:{port.read_text().split()[0]}/bench"
                sender = start([build / "bin/eigencast-sender", "deform", model, "--rank", str(rank), "--size", f"{WIDTH}x{HEIGHT}", "--to",
                                url, "--json", report, *more], env=environment, stderr=out)
            until(lambda: b"live at" in log.read_bytes(), 120)
            samples = folder / "samples.csv"
            watcher = start([build / "bin/eigencast-latency", "passive", url, "--warmup", "1", "--duration", "600", "--no-progress", "--samples",
                             samples], stdout=subprocess.DEVNULL)
            time.sleep(3)

            def hand(*arguments):
                subprocess.run(["xdotool", *map(str, arguments)], env=environment, check=True)

            hand("key", "t")
            # The knob of y stands about so far above the middle; beside it, the view would turn, and no pose be made.
            x, y = WIDTH // 2, HEIGHT // 2 - 90
            for drag in range(drags):
                way = [argument for step in range(1, 41)
                       for argument in ("mousemove", x + (2 * step if drag % 2 == 0 else -2 * step), y, "sleep", "0.025")]
                hand("mousemove", x, y, "sleep", "0.1", "mousedown", 1, *way, "mouseup", 1)
                hand("key", "ctrl+z")
            time.sleep(0.5)
            watcher.send_signal(signal.SIGINT)
            watcher.wait(30)
            hand("key", "q")
            sender.wait(30)
            with open(samples) as file:
                watched = [pose for pose in csv.DictReader(file) if int(pose["schedule_us"]) > MIN_BY_HAND_US]
            return json.loads(report.read_text()), watched
        finally:
            for process in reversed(processes):
                process.kill()
                process.wait()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("build", type=pathlib.Path)
    parser.add_argument("models", nargs="*", default=["heart"])
    parser.add_argument("--rank", type=int, default=200)
    parser.add_argument("--handles", help="handles.json: as rigid as possible, without a cage")
    parser.add_argument("--drags", type=int, default=4)
    parser.add_argument("--repeat", type=int, default=3)
    arguments = parser.parse_args()
    for model in arguments.models or ["heart"]:
        runs = [run(arguments.build.resolve(), model, arguments.rank, arguments.drags,
                    ["--handles", arguments.handles] if arguments.handles else []) for _ in range(arguments.repeat)]
        reports, watched = [report for report, _ in runs], [pose for _, poses in runs for pose in poses]
        print(f"{model}: {reports[0]['handles']} handles, {sum(r['poses_by_hand'] for r in reports)} poses, {reports[0]['graphics']}")
        for stage in STAGES:
            p50, p99 = ([r[stage][p] / 1000 for r in reports] for p in ("p50", "p99"))
            print(f"  {stage[:-3].replace('_', ' '):22} {statistics.median(p50):7.2f} ms ({min(p50):.2f} to {max(p50):.2f}), p99 {max(p99):.2f} ms, "
                  f"{sum(r[stage]['count'] for r in reports)} poses")
        print(f"  as eigencast-latency passive sees them, medians of {len(watched)} poses, ms: "
              + ", ".join(f"{stage.replace('_', ' ')} {statistics.median(int(pose[f'{stage}_us']) for pose in watched) / 1000:.3f}"
                          for stage in WATCHED if watched))


main()
