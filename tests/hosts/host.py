# SPDX-License-Identifier: MIT
"""What the tests of hosts share: a broker, the snippets of docs/hosts.md, and poses that are followed from the host to a viewer.

    HOST_test.py BUILD_FOLDER SOURCE_FOLDER [--measure]      --measure prints what a pose costs, for docs/hosts.md
"""
import os
import pathlib
import re
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import unittest

BUILD, SOURCE = (pathlib.Path(word).resolve() for word in sys.argv[1:3])
MEASURE = "--measure" in sys.argv
sys.dont_write_bytecode = True
os.environ["EIGENCAST_LIBRARY"] = str(BUILD / "lib/libeigencast.so.0")
os.environ["PYTHONPATH"] = str(SOURCE / "sdk/python")
sys.path.insert(0, os.environ["PYTHONPATH"])
_folder = tempfile.TemporaryDirectory()
os.environ["EIGENCAST_CACHE"] = os.environ["XDG_CACHE_HOME"] = _folder.name + "/cache"

import numpy  # noqa: E402

import eigencast  # noqa: E402


def snippets(section):
    """The Python of that section of docs/hosts.md, a text for each block."""
    page = (SOURCE / "docs/hosts.md").read_text(encoding="utf-8")
    found = re.search(rf"^## {re.escape(section)}\n(.*?)(?=^## |\Z)", page, re.M | re.S)
    return re.findall(r"^```python\n(.*?)^```", found[1], re.M | re.S)


def z_up(rows):
    """Points that were sent with z up, as they arrive."""
    return numpy.stack([rows[:, 0], rows[:, 2], -rows[:, 1]], axis=1)


class Broker:
    """with Broker() as origin: http://host:port"""

    def __enter__(self):
        port = pathlib.Path(_folder.name) / f"port-{time.monotonic_ns()}"
        self.process = subprocess.Popen([BUILD / "bin/eigencast-broker", "--listen", "127.0.0.1:0", "--admin-listen", "", "--port-file", port],
                                        env={**os.environ, "XDG_STATE_HOME": _folder.name}, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        end = time.monotonic() + 60
        while not port.exists() or not port.read_text().endswith("\n"):
            if time.monotonic() > end or self.process.poll() is not None:
                raise RuntimeError("the broker did not start")
            time.sleep(0.02)
        return "http://127.0.0.1:" + port.read_text().split()[0]

    def __exit__(self, *_):
        self.process.terminate()
        self.process.wait()


class HostTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.broker = Broker()
        cls.origin = cls.broker.__enter__()
        cls.addClassCleanup(cls.broker.__exit__)

    def code(self, section, number=0):
        """A snippet as the page has it, but for the broker."""
        text = snippets(section)[number]
        self.assertIn("http://localhost:7490", text)
        return text.replace("http://localhost:7490", self.origin)

    def follow(self, url, count, send, expected, tolerance):
        """send(i) makes the host send pose i once the one before has come. Each must come, in order, with expected(i), (n, 3)."""
        with eigencast.Subscriber(url + "?rate=raw") as subscriber:
            last = None
            for i in range(count):
                send(i)
                wanted, end = expected(i), time.monotonic() + 120
                while True:
                    self.assertLess(time.monotonic(), end, f"pose {i} of {count} has not come: {subscriber.stats()}")
                    pose = subscriber.next(timeout=0.1)
                    if pose is None or len(pose.positions) != len(wanted):
                        continue
                    off = numpy.abs(pose.in_source_order() - wanted).max()
                    if last is not None or off < tolerance:  # the first may be one from before
                        break
                if last is not None:
                    self.assertEqual(pose.sequence, last.sequence + 1)
                self.assertLess(off, tolerance)
                last = pose
            return last


def measure(host, make, count=200, rate_hz=25):
    """Prints what a pose takes of its host, and what a viewer gets. make(origin, n): (stream, url, points, advance(i), send()), about n points."""
    with Broker() as origin:
        for n in (2_000, 10_000, 40_000):
            stream, url, points, advance, send = make(origin, n)
            with eigencast.Subscriber(url + "?rate=raw") as viewer:
                pose = None
                while pose is None or len(pose.positions) < points:
                    advance(0)
                    send()
                    pose = viewer.next(timeout=0.5)
                while viewer.next(timeout=0.5):
                    pass
                viewer.max_vertices = 1  # pictures are another program's matter
                taken_s, came, ended, before, start = [], [], threading.Event(), stream.stats, time.monotonic()

                def see():
                    while (pose := viewer.next(timeout=0.5)) is not None or not ended.is_set():
                        came.extend([] if pose is None else [pose.sequence])

                seeing = threading.Thread(target=see)
                seeing.start()
                for i in range(1, count + 1):
                    advance(i)
                    at = time.perf_counter()
                    send()
                    taken_s.append(time.perf_counter() - at)
                    time.sleep(max(0, start + i / rate_hz - time.monotonic()))
                ended.set()
                seeing.join()
                after = stream.stats
            ordered = came == list(range(came[0], came[0] + len(came)))
            print(f"{host} | {points} points | {1e3 * statistics.median(taken_s):.2f} ms a pose | sent {after.poses_sent - before.poses_sent} of {count}, "
                  f"early {after.poses_early - before.poses_early}, dropped {after.poses_dropped - before.poses_dropped} | "
                  f"came {len(came)}{', all in order' if ordered else ', with gaps'}", flush=True)


def main(host, make):
    if MEASURE:
        measure(host, make)
    else:
        unittest.main(module="__main__", argv=sys.argv[:1])
