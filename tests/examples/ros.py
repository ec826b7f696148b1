#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Runs an example as a node of ROS 1, beside a master and a node that shows a flag: ros.py COMMAND..., from examples_test.py.

The flag is a marker of triangles that waves, and is deleted 60 poses after the first one that a viewer saw (the file `seen`).
"""
import math
import os
import pathlib
import subprocess
import sys
import time

import rosmaster.master
import rospy
from geometry_msgs.msg import Point
from visualization_msgs.msg import Marker

SIDE, RATE_HZ, POSES = 20, 25, 60


def flag(t):
    points = [Point(x / SIDE, x / SIDE * 0.15 * math.sin(6 * x / SIDE - 4 * t), z / SIDE) for z in range(SIDE + 1) for x in range(SIDE + 1)]
    made = Marker(type=Marker.TRIANGLE_LIST, action=Marker.ADD)
    made.header.stamp = rospy.Time.now()
    for a in (z * (SIDE + 1) + x for z in range(SIDE) for x in range(SIDE)):
        made.points += [points[k] for k in (a, a + 1, a + SIDE + 2, a, a + SIDE + 2, a + SIDE + 1)]
    return made


def main():
    os.environ.update(ROS_IP="127.0.0.1", ROS_LOG_DIR=str(pathlib.Path.cwd() / "log"))
    master = rosmaster.master.Master(port=0)
    master.start()
    os.environ["ROS_MASTER_URI"] = master.uri
    with subprocess.Popen(sys.argv[1:]) as node:
        rospy.init_node("flag", disable_signals=True)
        topic = rospy.Publisher("/visualization_marker", Marker, queue_size=1)
        left = POSES
        while left > 0 and node.poll() is None:
            left -= pathlib.Path("seen").exists()
            topic.publish(flag(time.monotonic()))
            time.sleep(1 / RATE_HZ)
        while node.poll() is None:  # a queue of one may lose it
            topic.publish(Marker(action=Marker.DELETE))
            time.sleep(0.1)
    rospy.signal_shutdown("done")
    master.stop()
    sys.exit(node.returncode)


main()
