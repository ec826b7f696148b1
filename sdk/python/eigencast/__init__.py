# SPDX-License-Identifier: MIT
"""Publish and watch deforming 3D surfaces: libeigencast from Python, by ctypes and numpy.

    asset = eigencast.bake(positions, faces)              # (n, 3) floats, (F, 3) integers; no faces: a point cloud
    with eigencast.Publisher("http://broker:7490/demo", asset) as publisher:
        publisher.send(positions)                         # never blocks

    with eigencast.Stream("http://broker:7490/demo") as stream:  # the same in one: bakes in a thread, at other faces again
        stream.send(positions, faces)

    with eigencast.Subscriber("http://broker:7490/demo") as subscriber:
        pose = subscriber.next(timeout=1.0)               # a Pose, or None if none came

    png = eigencast.picture("http://broker:7490/demo")    # of now; eigencast.show(url): in a notebook

Errors are raised as Error; what becomes of a pose that is sent is a value (Sent). An object is used from one thread at a time;
different ones are independent. Arrays of a Pose are copies, which stay, but for those of watch().
"""
from . import mesh
from ._library import Error, Status, library_path, now_us, version
from ._stream import Stream, StreamStats, Taken
from ._picture import Shown, picture, show
from ._objects import Asset, Past, Pose, Publisher, PublisherStats, Scalar, Sent, Subscriber, SubscriberStats, bake, load, watch

__all__ = ["Asset", "Error", "Past", "Pose", "Publisher", "PublisherStats", "Scalar", "Sent", "Shown", "Status", "Stream", "StreamStats", "Subscriber", "SubscriberStats", "Taken", "bake",
           "library_path", "load", "mesh", "now_us", "picture", "show", "version", "watch"]
__version__ = version()
