#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Streams a coloured or textured sheet: painted.py http://127.0.0.1:7490/sheet [IMAGE]; see docs/sdk.md."""
import sys
import time

import eigencast
import numpy

side = 24
y, x = numpy.mgrid[0:side, 0:side] / (side - 1)
rest = numpy.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
corner = (numpy.arange(side - 1)[:, None] * side + numpy.arange(side - 1)).ravel()
faces = numpy.concatenate([numpy.stack([corner, corner + 1, corner + side], axis=1),
                           numpy.stack([corner + 1, corner + side + 1, corner + side], axis=1)])
if len(sys.argv) > 2:
    with open(sys.argv[2], "rb") as file:
        appearance = {"image": file.read(), "vertex_uv": numpy.stack([rest[:, 0], 1 - rest[:, 1]], axis=1)}  # v from above
else:
    appearance = {"vertex_colours": (255 * numpy.stack([rest[:, 0], rest[:, 1], 0 * rest[:, 0]], axis=1)).round().astype("uint8")}
asset = eigencast.bake(rest, faces, rank=60, **appearance)
with eigencast.Publisher(sys.argv[1], asset) as publisher:
    for frame in range(300):
        height = 0.1 * numpy.sin(6 * rest[:, 0] + 0.1 * frame)
        publisher.send(rest + numpy.outer(height, [0, 0, 1]))
        time.sleep(0.033)
