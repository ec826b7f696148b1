#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""The viewer's figures without a graphics card, one after the other, on a machine that does nothing else: heart, horse and
six horses at 1280 x 720 with the client's own control, then Figures 6, 7 and 13 of Zhang et al. 2013. Five minutes."""
import json
import subprocess
import sys

from common import bench_parser, clip_argument, pathlib, tempfile, write_table

HERE = pathlib.Path(__file__).parent
SCENES = {"heart": ("heart", 1, 20), "horse": ("horse-gallop", 1, 20), "six horses": ("horse-gallop", 6, 15)}


def herd(clip, count):
    """Two rows, each surface beside the next by less than its own length."""
    return {"surfaces": [{"file": clip, "position": [1.1 * (i // 3), 0, 0.45 * (i % 3)]} for i in range(count)]}


def drawn(options, folder, name):
    clip, count, rate = SCENES[name]
    scene, report = folder / "scene.json", folder / "report.json"
    scene.write_text(json.dumps(herd(clip_argument(options, clip), count)))
    subprocess.run([options.bin / "eigencast-client", "--scene", scene, "--headless", "--resolver", "budget", "--quality", "auto",
                    "--target-fps", str(rate), "--size", "1280x720", "--duration", str(options.seconds), "--report", report],
                   check=True, capture_output=True)
    r = json.loads(report.read_text())
    lowered, quality, work = r["lowered"], r["quality"], r["frame_time_us"]["work"]
    vertices = lowered["vertices"] if lowered["pictures"] else {"mean": 1, "p5": 1}
    return [name, rate, r["frames_out"]["drawn"], f"{r['rates_hz']['drawn']:.1f}", f"{work['p50'] / 1000:.1f}", lowered["pictures"],
            f"{100 * vertices['mean']:.0f}", f"{100 * vertices['p5']:.0f}", f"{100 * lowered['used']['p5']:.0f}" if lowered["pictures"] else "-",
            f"{quality['scale']:.2f}, {quality['samples']}, {quality['shadow']}, {'ground' if quality['ground'] else 'none'}"]


def main():
    p = bench_parser(__doc__)
    p.add_argument("--seconds", type=float, default=25, help="of each scene")
    options = p.parse_args()
    with tempfile.TemporaryDirectory(prefix="eigencast-viewer-") as folder:
        table = [drawn(options, pathlib.Path(folder), name) for name in SCENES]
    write_table(options, "viewer_figures", ["scene", "wanted /s", "pictures", "rate/s", "work p50 ms", "lowered", "% of vertices", "p5 %",
                                            "budget used p5 %", "at last: scale, samples, shadow, ground"], table)
    same = ["--bin", options.bin, "--out", options.out, *(["--data", options.data] if options.data else [])]
    flight = [HERE / "figure_6_7.py", "--programs", options.programs, "--seconds", "10"]
    failed = 0
    for arguments in (flight, [*flight, "--model", "--out", options.out / "model"], [HERE / "figure_13.py"]):
        print(f"\n{arguments[0].name}{' --model' if '--model' in arguments else ''}", flush=True)
        failed |= subprocess.run([sys.executable, arguments[0], *map(str, same), *map(str, arguments[1:])], check=False).returncode
    sys.exit(failed)


if __name__ == "__main__":
    main()
