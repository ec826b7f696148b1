#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""A cloth of springs that hangs by two corners and swings, in NumPy alone: springs.py http://127.0.0.1:7490/cloth."""
import sys
import time

import eigencast
import numpy

SIDE, POSES, STEPS, DT = 30, 120, 8, 1 / 240

grid = numpy.arange(SIDE * SIDE).reshape(SIDE, SIDE)
points = numpy.stack([grid % SIDE, 0 * grid, grid // SIDE], axis=-1).reshape(-1, 3) / (SIDE - 1)
squares = numpy.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=-1).reshape(-1, 4)
pairs = [(grid[a:, b:] if b >= 0 else grid[a:, :b], grid[:SIDE - a, :SIDE - b] if b >= 0 else grid[:SIDE - a, -b:])
         for a, b in ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0))]
first, second = (numpy.concatenate([pair[side].ravel() for pair in pairs]) for side in (0, 1))
length = numpy.linalg.norm(points[first] - points[second], axis=1)
held = [grid[0, 0], grid[0, -1]]


def step(points, before):
    """Verlet, then each spring pulls its ends to its length, 6 times (Jakobsen, Advanced character physics, 2001)."""
    after = points + 0.998 * (points - before) + [0, -9.81 * DT * DT, 0.3 * DT * DT]
    after[held] = points[held]
    for _ in range(6):
        along = after[first] - after[second]
        pull = 0.25 * (1 - length / numpy.linalg.norm(along, axis=1))[:, None] * along
        for axis in range(3):
            after[:, axis] += (numpy.bincount(second, pull[:, axis], len(after)) - numpy.bincount(first, pull[:, axis], len(after))) / 2
        after[held] = points[held]
    return after, points


with eigencast.Stream(sys.argv[1]) as stream:
    stream.send(points, squares)  # bakes
    while not stream.stats.subscribers:  # so that a viewer sees it from its beginning
        time.sleep(0.05)
    before = points
    for _ in range(1, POSES):
        for _ in range(STEPS):
            points, before = step(points, before)
        time.sleep(1 / 30)
        stream.send(points)
print(f"sent {POSES} poses")
