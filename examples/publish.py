#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Publishes a waving sheet for ten seconds: publish.py http://127.0.0.1:7490/sheet."""
import sys
import time

import eigencast
import numpy

side = 24
y, x = numpy.mgrid[0:side, 0:side]
rest = numpy.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1).astype(float)
corner = (numpy.arange(side - 1)[:, None] * side + numpy.arange(side - 1)).ravel()
faces = numpy.concatenate([numpy.stack([corner, corner + 1, corner + side], axis=1),
                           numpy.stack([corner + 1, corner + side + 1, corner + side], axis=1)])

asset = eigencast.bake(rest, faces, rank=60)
sent = 0
with eigencast.Publisher(sys.argv[1], asset) as publisher:
    for frame in range(300):
        pose = rest.copy()
        pose[:, 2] = numpy.sin(0.3 * rest[:, 0] + 0.1 * frame)
        sent += publisher.send(pose) is eigencast.Sent.SENT
        time.sleep(0.033)
print(f"sent {sent} poses")
sys.exit(sent == 0)
