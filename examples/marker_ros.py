#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""A ROS 1 node that streams a topic of markers, visualization_msgs/Marker of triangles, until one of them deletes it:
marker_ros.py http://127.0.0.1:7490/marker [_topic:=/visualization_marker]
"""
import math
import sys
import time

import eigencast
import numpy
import rospy
from visualization_msgs.msg import Marker

stream = eigencast.Stream(sys.argv[1], up="z", max_rate_hz=math.inf)
joined, sent = None, 0  # how many corners there are, which of them are the points, and the faces over those


def take(marker):
    """A marker repeats a point for each of its triangles: joined as in the first one they are a surface."""
    global joined, sent
    if marker.action == Marker.DELETE:
        rospy.signal_shutdown("the marker is deleted")
    elif marker.type == Marker.TRIANGLE_LIST:
        corners = numpy.array([(p.x, p.y, p.z) for p in marker.points])
        if joined is None or joined[0] != len(corners):
            joined = len(corners), *eigencast.mesh.weld(corners, numpy.arange(len(corners)).reshape(-1, 3))
        stream.send(corners[joined[1]], joined[2], time_s=marker.header.stamp.to_sec())
        sent += 1
        while sent == 1 and not stream.stats.subscribers and not rospy.is_shutdown():  # so that a viewer sees it from its beginning
            time.sleep(0.05)


rospy.init_node("eigencast")
rospy.Subscriber(rospy.get_param("~topic", "/visualization_marker"), Marker, take, queue_size=1)
rospy.spin()
stream.close()
print(f"sent {sent} poses")
