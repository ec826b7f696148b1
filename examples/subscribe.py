#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Prints thirty poses of a stream: subscribe.py http://127.0.0.1:7490/sheet."""
import itertools
import sys

import eigencast

with eigencast.Subscriber(sys.argv[1], detail=0.5) as subscriber:
    for pose in itertools.islice(subscriber, 30):
        low, high = pose.positions.min(axis=0), pose.positions.max(axis=0)
        print(f"{len(pose.positions)} vertices from {low} to {high}, captured {eigencast.now_us() - pose.capture_us} us ago")
