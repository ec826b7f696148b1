#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Whether `--bitrate` holds, and how smoothly (docs/performance/codec.md, "Rate control").

One sender per clip and target, all at once, each watched raw over a plain WebSocket that notes every frame: its size with the envelope, which
is what the target is of, its spacing of levels and its bands. The first six seconds are for settling.
"""
import sys
import threading
import time

from common import ROOT, Stage, clip_argument, np, parser, plt, write_picture, write_table

sys.path[:0] = [str(ROOT / "tests/support"), str(ROOT / "bench/broker")]
import payloads
from websocket_peer import BINARY, Peer

CLIPS = ("horse-gallop", "elephant-gallop", "human-walk")
TARGETS = (None, 30, 20, 12)  # kbit/s; None: as the error bound takes.
RATE, SETTLING = 30, 6
HEADER = ["clip", "target kbit/s", "kbit/s", "off %", "of a second, least", "most", "spacing, median", "largest change of a frame, octaves",
          "octaves wandered a second", "least bands"]


class Viewer(threading.Thread):
    """Frames of one stream as (capture_us, bytes, half spacing, bands); of joins, which are exact, no spacing."""

    def __init__(self, port, stream, seconds):
        super().__init__(daemon=True)
        self.frames, self.seconds, self.chain = [], seconds, payloads.Chain()
        self.peer = Peer(port, f"/v1/subscribe/{stream}?rate=raw", "eigencast.v2")
        self.peer.sock.settimeout(60)

    def run(self):
        while not self.frames or self.frames[-1][0] - self.frames[0][0] < self.seconds * 1e6:
            opcode, payload = self.peer.receive()
            head = self.chain.read(payload) if opcode == BINARY else None
            if head and head.kind == payloads.KEY:
                self.frames.append((head.capture_us, len(payload), payload[head.size] >> 2, head.bands.bit_count()))


def row_of(clip, target, frames):
    steady = frames[frames[:, 0] >= frames[0, 0] + SETTLING * 1e6]
    span_s = (steady[-1, 0] - steady[0, 0]) * 1e-6
    kbit = 8e-3 * steady[1:, 1].sum() / span_s
    seconds = [8e-3 * steady[i:i + RATE, 1].sum() for i in range(0, len(steady) - RATE, RATE)]
    octaves = np.abs(np.diff(np.log2(steady[:, 2])))
    return [clip, target or "none", f"{kbit:.1f}", f"{100 * (kbit / target - 1):+.1f}" if target else "", f"{min(seconds):.1f}", f"{max(seconds):.1f}",
            f"{np.median(steady[:, 2]):.0f}", f"{octaves.max():.2f}", f"{octaves.sum() / span_s:.2f}", int(steady[:, 3].min())]


def main():
    p = parser(__doc__)
    p.add_argument("--seconds", type=float, default=24, help="watched, with those of settling")
    options = p.parse_args()
    runs = {}
    with Stage(options) as stage:
        clips = {clip: clip_argument(options, clip) for clip in CLIPS}
        for clip in clips.values():
            stage.bake(clip)
        for clip, path in clips.items():
            for target in TARGETS:
                stream = f"{clip}-{target}"
                stage.start("eigencast-sender", "--no-progress", "play", "--wait", path, "--rank", 200, "--rate", RATE, "--to", stage.url(stream),
                            *(["--bitrate", target] if target else []))
                runs[clip, target] = Viewer(stage.port, stream, options.seconds)
                runs[clip, target].start()
        deadline = time.monotonic() + options.seconds + 60
        for viewer in runs.values():
            viewer.join(max(0, deadline - time.monotonic()))
    if any(viewer.is_alive() for viewer in runs.values()):
        sys.exit("not every stream came to its end")
    frames = {run: np.array(viewer.frames, dtype=float) for run, viewer in runs.items()}
    write_table(options, "rate_control", HEADER, [row_of(*run, of) for run, of in frames.items()])
    figure, axes = plt.subplots(2, len(CLIPS), figsize=(14, 6), sharex=True, sharey="row")
    for column, clip in zip(axes.T, CLIPS):
        for target in TARGETS:
            of = frames[clip, target]
            at = (of[RATE:, 0] - of[0, 0]) * 1e-6
            colour = column[0].plot(at, 8e-3 * np.convolve(of[:, 1], np.ones(RATE), "valid")[1:], label=f"--bitrate {target}" if target else "free")[0].get_color()
            column[1].plot((of[:, 0] - of[0, 0]) * 1e-6, of[:, 2], color=colour)
            if target:
                column[0].axhline(target, color=colour, linewidth=0.6, linestyle="--")
        column[0].set_title(clip)
        column[1].set_xlabel("s")
    axes[0, 0].set_ylabel("kbit/s of the last second")
    axes[1, 0].set_ylabel("half spacing of levels")
    axes[1, 0].set_yscale("log", base=2)
    axes[0, 0].legend(fontsize=8)
    for axis in axes.flat:
        axis.grid(alpha=0.3)
    write_picture(options, "rate_control", figure)


if __name__ == "__main__":
    main()
