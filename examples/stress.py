#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Streams a sheet with a scalar on each vertex: stress.py http://127.0.0.1:7490/sheet; see docs/sdk.md."""
import sys
import time

import eigencast
import numpy

side = 24
y, x = numpy.mgrid[0:side, 0:side] / side
rest = numpy.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
corner = (numpy.arange(side - 1)[:, None] * side + numpy.arange(side - 1)).ravel()
faces = numpy.concatenate([numpy.stack([corner, corner + 1, corner + side], axis=1),
                           numpy.stack([corner + 1, corner + side + 1, corner + side], axis=1)])
asset = eigencast.bake(rest, faces, rank=60)
with eigencast.Publisher(sys.argv[1], asset, scalars=[eigencast.Scalar("stress", "MPa", 0, 1)]) as publisher:
    for frame in range(300):
        height = 0.1 * numpy.sin(6 * rest[:, 0] + 0.1 * frame)
        stress = 10 * numpy.abs(height)  # bent most where it is highest
        publisher.send(rest + numpy.outer(height, [0, 0, 1]), scalars=stress)
        time.sleep(0.033)
