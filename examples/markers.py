#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Markers on an arm that a camera tracks, a template cloud of them: markers.py http://127.0.0.1:7490/arm.

Each pose has the same markers in the same order (as trackers and fits of a template, such as SMPL, give them): that is what a stream of
points takes. Clouds of a scanner without such a correspondence are another surface each time, and not covered.
"""
import sys
import time

import eigencast
import numpy

MARKERS, POSES, NOISE = 4000, 120, 2e-4  # metres

random = numpy.random.default_rng(1)
# The template: along an arm of 60 cm with its elbow in the middle, a thickness that swells and narrows.
along, around = random.uniform(0, 0.6, MARKERS), random.uniform(0, 2 * numpy.pi, MARKERS)
radius = 0.045 - 0.03 * along + 0.008 * numpy.sin(11 * along)
template = numpy.stack([along - 0.3, radius * numpy.cos(around), radius * numpy.sin(around)], axis=1)
lower = 1 / (1 + numpy.exp(-40 * (along - 0.3)))[:, None]  # how far a marker goes with the forearm


def tracked(bend, twist):
    """What the camera sees: the forearm bends at the elbow and turns about itself, as linear blend skinning has it."""
    c, s = numpy.cos(twist), numpy.sin(twist)
    turned = template @ numpy.array([[1, 0, 0], [0, c, s], [0, -s, c]])
    c, s = numpy.cos(bend), numpy.sin(bend)
    posed = turned @ numpy.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    return (1 - lower) * template + lower * posed + random.normal(0, NOISE, template.shape)


with eigencast.Stream(sys.argv[1], rank=60, error=NOISE) as stream:
    stream.send(template)  # no faces: a cloud
    while not stream.stats.subscribers:
        time.sleep(0.05)
    for pose in range(1, POSES):
        swing = 1 - numpy.cos(2 * numpy.pi * pose / 60)
        time.sleep(1 / 30)
        stream.send(tracked(0.9 * swing, 0.4 * swing))
print(f"sent {POSES} poses")
