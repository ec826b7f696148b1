#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""What each scheme of interpolation and estimation is off by, on real clips and built-in motions (docs/performance/time.md).

Frames between keys of 15, 10 and 6 a second, and frames beyond the newest of 30 keys a second: root mean square distance, percent of
the diagonal. All schemes are linear in the poses, so that what holds of vertices holds of coefficients; real clips are taken as
vertices, built-in motions as uncompressed coefficients with the velocities that their sender gives (Hermite).
"""
from common import Stage, clip_argument, np, parser, plt, skip, truth_of, write_picture, write_table

REAL = ("horse-gallop", "elephant-gallop", "fox-run", "human-walk", "ict-face")
BUILT_IN = {"heart": 30, "sphere": 90, "torus": 60}
BETWEEN = ("hold", "linear", "parabola", "Catmull-Rom", "Hermite")
BEYOND = ("hold", "Eq. 9", "damped 27/32", "damped 0.7")


def parabola_slope(before, at, after):
    """Of the parabola through three even poses, at the middle one, per key interval."""
    return (after - before) / 2


def between(scheme, keys, u, velocities):
    """keys: the pose before, from, to, after; velocities per key interval, of from and to."""
    before, start, end, after = keys
    h00, h10 = (1 + 2 * u) * (1 - u) ** 2, u * (1 - u) ** 2
    h01, h11 = u * u * (3 - 2 * u), u * u * (u - 1)
    if scheme == "hold":
        return start
    if scheme == "linear":
        return start + u * (end - start)
    if scheme == "parabola":
        return start + u * (end - start) + u * (u - 1) / 2 * (end - 2 * start + before)
    if scheme == "Catmull-Rom":
        m0, m1 = parabola_slope(before, start, end), parabola_slope(start, end, after)
    else:
        m0, m1 = velocities
    return h00 * start + h10 * m0 + h01 * end + h11 * m1


def beyond(scheme, older, newer, h):
    if scheme == "hold":
        return newer
    damping = {"Eq. 9": 1, "damped 27/32": 27 / 32, "damped 0.7": 0.7}[scheme]
    return newer + sum(damping ** i for i in range(1, h + 1)) * (newer - older) if damping < 1 else newer + h * (newer - older)


class Clip:
    """frames: F x values. error() is in percent of the diagonal."""

    def __init__(self, frames, values_per_square, diagonal, velocities=None):
        self.frames, self.scale = frames, 100 * values_per_square ** -0.5 / diagonal
        self.velocities = velocities

    def rms(self, squares):
        return self.scale * np.sqrt(np.mean(squares))

    def between(self, scheme, every):
        if scheme == "Hermite" and self.velocities is None:
            return None
        squares = []
        for first in range(every, len(self.frames) - 2 * every, every):
            keys = [self.frames[first + i * every] for i in (-1, 0, 1, 2)]
            moving = None
            if self.velocities is not None:
                moving = [self.velocities[first + i * every] * every / 30 for i in (0, 1)]
            for step in range(1, every):
                made = between(scheme, keys, step / every, moving)
                squares.append(np.sum((made - self.frames[first + step]) ** 2))
        return self.rms(squares)

    def beyond(self, scheme, h):
        return self.rms([np.sum((beyond(scheme, self.frames[i - 1], self.frames[i], h) - self.frames[i + h]) ** 2)
                         for i in range(1, len(self.frames) - h)])


def clips_of(options):
    for name in REAL:
        poses = np.load(clip_argument(options, name)).astype(float)
        diagonal = np.linalg.norm(poses[0].max(axis=0) - poses[0].min(axis=0))
        yield name, Clip(poses.reshape(len(poses), -1), poses.shape[1], diagonal)
    with Stage(options) as stage:
        for name, frames in BUILT_IN.items():
            both, surface = truth_of(stage, name, frames, velocities=True)
            yield name, Clip(both[:, :, :3].reshape(frames, -1), surface["area"], surface["diagonal"],
                             both[:, :, 3:].reshape(frames, -1))


def main():
    options = parser(__doc__).parse_args()
    rows, curves = [], {}
    for name, clip in clips_of(options):
        for every in (2, 3, 5):
            errors = [clip.between(scheme, every) for scheme in BETWEEN]
            curves[name, every] = errors
            rows.append([name, f"{30 // every} keys/s", *("-" if e is None else f"{e:.3f}" for e in errors)])
        for h in (1, 2, 3, 6):
            rows.append([name, f"{h} beyond", *(f"{clip.beyond(scheme, h):.3f}" for scheme in BEYOND), ""])
    if not rows:
        skip("no clip")
    write_table(options, "motion_between", ["clip", "keys", *BETWEEN], [r for r in rows if "keys" in r[1]])
    write_table(options, "motion_beyond", ["clip", "frames", *BEYOND], [r[:6] for r in rows if "beyond" in r[1]])
    names = list(dict.fromkeys(name for name, _ in curves))
    figure, axes = plt.subplots(1, 3, figsize=(15, 4), sharey=True)
    for axis, every in zip(axes, (2, 3, 5)):
        for number, scheme in enumerate(BETWEEN):
            values = [curves[name, every][number] or 0 for name in names]
            axis.bar(np.arange(len(names)) + (number - 2) * 0.17, values, 0.16, label=scheme)
        axis.set_xticks(np.arange(len(names)), names, rotation=30, ha="right", fontsize=8)
        axis.set_yscale("log")
        axis.set_ylim(1e-4, 20)
        axis.set_title(f"{30 // every} keys/s", fontsize=10)
        axis.grid(axis="y", alpha=0.3)
    axes[0].set_ylabel("rms error of the poses between keys, % of the diagonal", fontsize=8)
    axes[0].legend(fontsize=7)
    write_picture(options, "motion_between", figure)


if __name__ == "__main__":
    main()
