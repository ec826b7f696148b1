#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Remote rendering as a peer of the coefficient stream: eigencast-client's pictures of clips, one for each pose, coded as video
at 30/s by x264 (-tune zerolatency: no frame waits for a later one) at two qualities.

Poses are sent slowly, so that a processor without a GPU draws all of them; the video takes them at 30/s. The delay is the time
that the encoder takes for a picture, drawing and reading PNG files not counted. bench/paper/figure_08.py draws the result.
"""
import pathlib
import re
import shutil
import subprocess
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "paper"))
from common import Stage, clip_argument, drawn, np, parser, skip, watch, write_table  # noqa: E402

CLIPS = ("horse-gallop", "human-walk", "elephant-gallop")
QUALITIES = (23, 30)  # crf
PICTURES_PER_S = 30


def draw(stage, options, name):
    """The folder of the pictures, frame_0001.png and on; those that --keep has from before, if there are as many."""
    kept = options.keep and options.keep / f"{name}-{options.size}"
    if kept and len(list(kept.glob("frame_*.png"))) >= options.pictures:
        return kept
    stage.bake(clip_argument(options, name))
    viewer = watch(stage, name, "rate=raw", 120, "--frames", options.pictures, size=options.size)
    sender = stage.start("eigencast-sender", "--no-progress", "play", "--wait", clip_argument(options, name), "--rate", options.pace, "--speed",
                         options.pace / PICTURES_PER_S, "--to", stage.url(name))
    lines, _ = drawn(stage, viewer)
    sender.terminate()
    sender.wait(20)
    gaps = np.diff([line["capture_us"] for line in lines])
    if np.max(gaps) > 1.5e6 / options.pace:
        sys.exit(f"{name}: a pose was not drawn in time; give --pace below {options.pace:g}")
    if not kept:
        return viewer.folder
    kept.mkdir(parents=True, exist_ok=True)
    for picture in viewer.folder.glob("frame_*.png"):
        shutil.copy(picture, kept)
    return kept


def code(raw, size, count, quality):
    """kbit/s, and what the encoder takes for one picture: milliseconds, and those of a processor."""
    video = raw.with_suffix(f".{quality}.h264")
    done = subprocess.run(["ffmpeg", "-hide_banner", "-y", "-benchmark", "-f", "rawvideo", "-pix_fmt", "yuv420p", "-s", size, "-r",
                           str(PICTURES_PER_S), "-i", raw, "-c:v", "libx264", "-tune", "zerolatency", "-crf", str(quality), "-f", "h264",
                           video], check=True, capture_output=True, text=True)
    user, system, real = (float(re.search(rf"{kind}time=([0-9.]+)s", done.stderr)[1]) for kind in "usr")
    return video.stat().st_size * 8e-3 * PICTURES_PER_S / count, 1000 * real / count, 1000 * (user + system) / count


def main():
    p = parser(__doc__)
    p.add_argument("--size", default="1440x900")
    p.add_argument("--pictures", type=int, default=40, help="of each clip")
    p.add_argument("--pace", type=float, default=2, help="poses a second that are drawn")
    p.add_argument("--clips", nargs="+", default=list(CLIPS))
    p.add_argument("--keep", type=pathlib.Path, help="folder that keeps the pictures: a second run only codes them")
    options = p.parse_args()
    if not shutil.which("ffmpeg"):
        skip("no ffmpeg, so nothing to compare with")
    rows = []
    with Stage(options) as stage:
        for name in options.clips:
            folder = draw(stage, options, name)
            count, raw = len(list(folder.glob("frame_*.png"))), stage.folder / f"{name}.yuv"
            subprocess.run(["ffmpeg", "-hide_banner", "-loglevel", "error", "-i", folder / "frame_%04d.png", "-pix_fmt", "yuv420p", "-f",
                            "rawvideo", raw], check=True)
            for quality in QUALITIES:
                rate, delay, processor = code(raw, options.size, count, quality)
                rows.append([name, options.size, quality, count, f"{rate:.0f}", f"{delay:.1f}", f"{processor:.1f}"])
            raw.unlink()
    write_table(options, "remote_rendering", ["clip", "size", "crf", "pictures", "kbit_per_s", "encode_ms", "processor_ms"], rows)


if __name__ == "__main__":
    main()
