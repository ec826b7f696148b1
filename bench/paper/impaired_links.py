#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Displayed error and delay of raw, interpolated and estimated modes over bad links (docs/performance/time.md).

For each link one sender plays to the broker directly; a viewer per mode watches through a relay of its own. What a picture
shows is compared with what the sender's surface was at the moment of display: the error includes the delay. Links are those of
eigencast-impaired-relay, which does to a TCP connection what loss, delay and a thin link do.
"""
import json
import subprocess

from common import Stage, clip_argument, lines_of, np, parser, plt, truth_of, write_picture, write_table

LINKS = {"none": "clean", "wlan": "20 +- 5 ms", "wan": "150 +- 50 ms, 5 % loss", "3g": "2 Mbit/s, 100 ms",
         "thin": "500 kbit/s"}
MODES = {
    "raw": ("rate=raw", []),
    "interpolated by the broker x3": ("rate=interpolated&k=3", []),
    "estimated by the broker x3": ("rate=estimated&k=3", []),
    "raw, interpolated by the viewer": ("rate=raw", ["--playout", "interpolate"]),
    "raw, estimated by the viewer": ("rate=raw", ["--playout", "estimate"]),
    "raw, half-way between": ("rate=raw", ["--playout", "estimate", "--smooth", "0.5"]),
}
CLIPS = {"heart": 30, "horse-gallop": 48, "human-walk": 120}
CLIP_HZ = 30


class Truth:
    """The sender's surface at any time: its frames at their capture times, straight between them."""

    def __init__(self, frames, surface, sent):
        self.frames, self.scale = frames, surface["area"] ** -0.5 / surface["diagonal"]
        self.zero_us = sent[0]["capture_us"] - sent[0]["frame"] * 1e6 / CLIP_HZ

    def frame_at(self, time_us):
        return (time_us - self.zero_us) * CLIP_HZ * 1e-6 % len(self.frames)

    def error(self, coefficients, time_us):
        """Root mean square distance over the surface, in diagonals."""
        at = self.frame_at(time_us)
        first = int(at)
        a, b = self.frames[first], self.frames[(first + 1) % len(self.frames)]
        return float(np.linalg.norm(coefficients - (a + (at - first) * (b - a)))) * self.scale


def sampled(shown, truth, clip_loops, seconds):
    """What was on display 60 times a second, after a settling time: errors (diagonals), delays (ms), share held."""
    times = np.array([line["drawn_us"] for line in shown])
    errors, delays, held = [], [], 0
    for now in np.arange(times[-1] - seconds * 1e6, times[-1], 1e6 / 60):
        frame = truth.frame_at(now)
        if not clip_loops and (frame < 0.6 * CLIP_HZ or len(truth.frames) - frame < 0.1 * CLIP_HZ):
            continue  # The clip's end does not go over into its beginning: that jump is nobody's error.
        line = shown[max(0, int(np.searchsorted(times, now, side="right")) - 1)]
        errors.append(truth.error(line["array"], now))
        delays.append((now - line["capture_us"]) / 1000)
        held += line["shown"] == "held"
    return np.array(errors), np.array(delays), held / max(1, len(errors))


def measure(stage, options, clip, link, frames, surface):
    folder = stage.folder / f"{clip}-{link}"
    folder.mkdir()
    stream = f"{clip}-{link}"
    sender = stage.start("eigencast-sender", "--no-progress", "play", "--wait", clip_argument(options, clip), "--rate", options.rate,
                         "--to", stage.url(stream), "--duration", options.seconds + 9, "--record", folder / "sent.jsonl")
    viewers = []
    for number, (query, arguments) in enumerate(MODES.values()):
        shown, report = folder / f"{number}.jsonl", folder / f"{number}.json"
        url = stage.url(stream, stage.relay(link, seed=7)) + "?" + query
        viewers.append((stage.start("eigencast-client", url, "--headless", "--size", "32x32", "--lod", "0.02", "--duration",
                                    options.seconds + 5, "--wait", 30, "--record-shown", shown, "--json", report,
                                    *arguments), shown, report))
    for process, _, _ in viewers:
        stage.wait(process, options.seconds + 60)
    sender.terminate()
    sender.wait(20)
    truth = Truth(frames, surface, lines_of(folder / "sent.jsonl"))
    rows = []
    for mode, (_, shown, report) in zip(MODES, viewers):
        lines = lines_of(shown)
        for line in lines:
            line["array"] = np.array(line["coefficients"]).reshape(len(frames[0]), -1)[:, :3]
        errors, delays, held = sampled(lines, truth, clip == "heart", options.seconds)
        drawn = np.array([line["drawn_us"] for line in lines])
        gaps = np.diff(drawn[drawn >= drawn[-1] - options.seconds * 1e6]) / 1000
        rows.append([clip, LINKS[link], mode, f"{100 * np.mean(errors):.2f}", f"{100 * np.percentile(errors, 95):.2f}",
                     f"{np.percentile(delays, 50):.0f}", f"{np.percentile(delays, 95):.0f}", f"{np.max(gaps):.0f}",
                     f"{100 * held:.0f}", f"{json.loads(report.read_text())['kbit_per_s']:.0f}"])
    return rows


def plot(options, clip, rows):
    figure, axes = plt.subplots(1, 2, figsize=(13, 4.6))
    links = list(LINKS.values())
    for axis, column, title in ((axes[0], 3, "mean displayed error, % of the diagonal"),
                                (axes[1], 6, "age of what is displayed, 95th percentile, ms")):
        for number, mode in enumerate(MODES):
            values = [float(next(r for r in rows if r[:3] == [clip, link, mode])[column]) for link in links]
            axis.bar(np.arange(len(links)) + (number - 2.5) * 0.14, values, 0.13, label=mode)
        axis.set_xticks(np.arange(len(links)), links, rotation=12, fontsize=8)
        axis.set_title(title, fontsize=10)
        axis.grid(axis="y", alpha=0.3)
    axes[1].legend(fontsize=7)
    figure.suptitle(f"{clip}, {options.rate:g} keys/s: against the sender's surface at the moment of display")
    write_picture(options, f"impaired_links_{clip}", figure)


def has_netem():
    probe = "ip link set lo up && tc qdisc add dev lo root netem delay 1ms"
    return subprocess.run(["unshare", "-n", "sh", "-c", probe], capture_output=True).returncode == 0


def main():
    p = parser(__doc__)
    p.add_argument("--rate", type=float, default=10, help="keys a second")
    p.add_argument("--seconds", type=float, default=10, help="measured of each link")
    p.add_argument("--clips", nargs="+", default=list(CLIPS), choices=list(CLIPS))
    p.add_argument("--links", nargs="+", default=list(LINKS), choices=list(LINKS))
    options = p.parse_args()
    for clip in options.clips:
        clip_argument(options, clip)
    print("netem: " + ("in this kernel" if has_netem() else "not in this kernel; the relay makes the links"))
    rows = []
    for clip in options.clips:
        with Stage(options) as stage:
            frames, surface = truth_of(stage, clip_argument(options, clip), CLIPS[clip])
            for link in options.links:
                rows += measure(stage, options, clip, link, frames, surface)
        if options.links == list(LINKS):
            plot(options, clip, rows)
    write_table(options, "impaired_links",
                ["clip", "link", "mode", "error mean %", "error p95 %", "delay p50 ms", "delay p95 ms", "longest still ms",
                 "held %", "kbit/s"], rows)


if __name__ == "__main__":
    main()
