#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""A bar that Open3D bends, each pose as rigid as possible: arap_open3d.py http://127.0.0.1:7490/bar."""
import sys
import time

import eigencast
import numpy
import open3d

POSES, RADIUS, HEIGHT = 60, 0.1, 1.0

mesh = open3d.geometry.TriangleMesh.create_cylinder(RADIUS, HEIGHT, resolution=24, split=40)
points, faces = numpy.asarray(mesh.vertices), numpy.asarray(mesh.triangles)
handles = [numpy.flatnonzero(side * points[:, 2] > 0.45 * HEIGHT) for side in (-1, 1)]  # the ends: one is held, one moved
ends = open3d.utility.IntVector(numpy.concatenate(handles).astype("int32"))


def moved(bend, twist):
    """Where the free end goes: it turns about its axis, then about the middle of the bar."""
    c, s = numpy.cos(twist), numpy.sin(twist)
    turned = points[handles[1]] @ numpy.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    c, s = numpy.cos(bend), numpy.sin(bend)
    return turned @ numpy.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])


with eigencast.Stream(sys.argv[1], up="z") as stream:
    stream.send(points, faces)
    while not stream.stats.subscribers:  # so that a viewer sees it from its beginning
        time.sleep(0.05)
    for i in range(1, POSES):
        swing = (1 - numpy.cos(numpy.pi * i / POSES)) / 2
        targets = numpy.concatenate([points[handles[0]], moved(1.2 * swing, 1.5 * swing)])
        pose = mesh.deform_as_rigid_as_possible(ends, open3d.utility.Vector3dVector(targets), max_iter=30)
        time.sleep(1 / 30)
        stream.send(numpy.asarray(pose.vertices))
print(f"sent {POSES} poses")
