#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""eigencast-igtl between a real broker and real peers: one of OpenIGTLink's own classes, and one that knows its bytes alone.

Usage: igtl_test.py BROKER BRIDGE PEER LIBRARY PACKAGE_FOLDER. PEER may be none: its tests are skipped.
"""
import os
import pathlib
import re
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
import unittest

try:
    import numpy
except ImportError:
    print("SKIPPED: numpy is not installed for this interpreter")
    sys.exit(77)

BROKER, BRIDGE, PEER, os.environ["EIGENCAST_LIBRARY"], PACKAGE = sys.argv[1:6]
sys.dont_write_bytecode = True
sys.path[:0] = [PACKAGE, str(pathlib.Path(__file__).resolve().parents[1] / "support")]
import cases  # noqa: E402
import eigencast  # noqa: E402

SIDE, POSES = 16, 12
TOLERANCE = 4e-3  # The coding's rms error is 0.1 % of the size, which is 1.4; what 200 coefficients leave out of such a sheet is less.


def checksum(data):
    crc = 0
    for byte in data:
        crc ^= byte << 56
        for _ in range(8):
            crc = (crc << 1 ^ (0x42F0E1EBA9EA3693 if crc >> 63 else 0)) & (1 << 64) - 1
    return crc


def header(body, version=1, kind="POLYDATA", device="Sheet", size=None, crc=None):
    return struct.pack(">H12s20sQQQ", version, kind.encode(), device.encode(), 0, len(body) if size is None else size,
                       checksum(body) if crc is None else crc)


def polydata(positions, triangles, **changed):
    """The body of a message; sizes may be changed."""
    sizes = dict(points=len(positions), vertices=0, vertices_size=0, lines=0, lines_size=0, polygons=len(triangles), polygons_size=16 * len(triangles),
                 strips=0, strips_size=0, attributes=0)
    cells = numpy.hstack([numpy.full((len(triangles), 1), 3), triangles])
    return struct.pack(">10I", *{**sizes, **changed}.values()) + positions.astype(">f4").tobytes() + cells.astype(">u4").tobytes()


def parsed(connection):
    """The next message: version, device, time, points, triangles."""
    def exactly(count):
        data = b""
        while len(data) < count:
            part = connection.recv(count - len(data))
            if not part:
                raise EOFError
            data += part
        return data

    version, kind, device, stamp, size, crc = struct.unpack(">H12s20sQQQ", exactly(58))
    body = exactly(size)
    assert kind.rstrip(b"\0") == b"POLYDATA" and crc == checksum(body)
    if version == 2:
        extended, meta_header, meta, _ = struct.unpack(">HHII", body[:12])
        body = body[extended:len(body) - meta_header - meta]
    sizes = struct.unpack(">10I", body[:40])
    points = numpy.frombuffer(body, ">f4", 3 * sizes[0], 40).reshape(-1, 3)
    cells = numpy.frombuffer(body, ">u4", sizes[6] // 4, 40 + points.nbytes).reshape(-1, 4)
    assert sizes[5] == len(cells) and (cells[:, 0] == 3).all()
    return version, device.rstrip(b"\0").decode(), stamp / 2**32, points, cells[:, 1:]


def sheet(pose=0):
    """As peer.cpp sends it."""
    y, x = (a.ravel().astype(float) for a in numpy.mgrid[0:SIDE, 0:SIDE])
    return numpy.stack([x / SIDE + 0.1 * pose, y / SIDE, 0.01 * x * (pose % 5)], axis=1)


def squares():
    corner = (numpy.arange(SIDE - 1)[:, None] * SIDE + numpy.arange(SIDE - 1)).ravel()
    return numpy.concatenate([numpy.stack([corner, corner + 1, corner + SIDE], axis=1),
                              numpy.stack([corner + 1, corner + SIDE + 1, corner + SIDE], axis=1)])


class Bridge:
    """The program, and where it listens."""

    def __init__(self, *arguments):
        self.process = subprocess.Popen([BRIDGE, *map(str, arguments), "--max-rate", "1000"], stderr=subprocess.PIPE, text=True)
        self.lines = []
        self.port = None
        while self.port is None and "--listen" in arguments:
            found = self.until("listens on ")
            self.port = int(found.rsplit(":", 1)[1])

    def until(self, what):
        for line in self.process.stderr:
            self.lines.append(line)
            if what in line:
                return line
        raise AssertionError(f"no '{what}' in {self.lines}")

    def peak_kib(self):
        return int(re.search(r"VmHWM:\s*(\d+)", pathlib.Path(f"/proc/{self.process.pid}/status").read_text())[1])

    def end(self):
        """All that it said. Asserts that a signal ends it well."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        rest = self.process.communicate(timeout=60)[1]
        assert self.process.returncode == 0, self.lines
        return "".join(self.lines) + rest

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()


class Bridging(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        folder = cls.enterClassContext(tempfile.TemporaryDirectory())
        os.environ["EIGENCAST_CACHE"] = folder + "/cache"
        port = pathlib.Path(folder) / "port"
        cls.broker = subprocess.Popen([BROKER, "--listen", "127.0.0.1:0", "--admin-listen", "127.0.0.1:0", "--port-file", port, "--data-dir",
                                       folder + "/assets"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        cls.addClassCleanup(cls.broker.wait)
        cls.addClassCleanup(cls.broker.terminate)
        end = time.monotonic() + 60
        while not port.exists() or not port.read_text().endswith("\n"):
            if time.monotonic() > end:
                raise RuntimeError("the broker did not start")
            time.sleep(0.02)
        cls.origin = "http://127.0.0.1:" + port.read_text().split()[0]

    def next_whole(self, subscriber, seconds=60):
        """None: there was none."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            pose = subscriber.next(timeout=0.05)
            if pose is not None and len(pose.positions) == SIDE * SIDE:
                return pose
        return None

    def connected(self, port):
        connection = socket.create_connection(("127.0.0.1", port), timeout=60)
        self.addCleanup(connection.close)
        return connection

    def peer(self, *arguments):
        if PEER == "none":
            self.skipTest("libopenigtlink-dev is not installed: no peer of its own classes")
        process = subprocess.Popen([PEER, *map(str, arguments)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1)
        self.addCleanup(process.communicate)
        self.addCleanup(process.kill)
        return process

    def test_what_a_peer_of_the_library_sends_is_streamed_pose_by_pose(self):
        url = self.origin + "/sent"
        with Bridge("in", url, "--listen", "0") as bridge, eigencast.Subscriber(url + "?rate=raw", cache_dir="") as subscriber:
            peer = self.peer("send", bridge.port)
            for i in range(POSES):
                peer.stdin.write("\n")
                pose = self.next_whole(subscriber)
                self.assertIsNotNone(pose, subscriber.stats())
                x, y, z = sheet(i).T  # z is up there, y here
                self.assertLess(numpy.abs(pose.in_source_order() - numpy.stack([x, z, -y], axis=1)).max(), TOLERANCE, i)
                self.assertEqual([s.name for s in pose.scalar_info], ["heat"])
                heat = numpy.empty(len(pose.scalars))
                heat[pose.source_vertex] = pose.scalars[:, 0]
                self.assertLess(numpy.abs(heat - (1e5 * numpy.tile(numpy.arange(SIDE), SIDE) if i >= 6 else 0)).max(), 2e4)
            self.assertEqual(len(pose.triangles), 2 * (SIDE - 1)**2, "squares are fanned, strips cut")
            self.assertRegex(bridge.end(), rf"{POSES} surfaces taken, 0 refused, 0 of other devices; of the present stream {POSES - 6} sent, 0 too")

    def test_a_peer_of_the_library_gets_a_stream_pose_by_pose(self):
        url = self.origin + "/got"
        peer = self.peer("receive")
        port = int(peer.stdout.readline())
        with eigencast.Stream(url, rank=100, scalars={"heat": (0, 16, "K")}, max_rate_hz=1e6, cache_dir="") as stream, \
                Bridge("out", url + "?rate=raw", "--connect", port, "--device", "Liver", "--scale", 0.5) as bridge:
            times = []
            bridge.until("connected with")
            for i in range(POSES):
                stream.send(sheet(i), squares(), scalars={"heat": numpy.tile(numpy.arange(SIDE), SIDE)})
                while True:
                    device, points, cells, attributes, stamp, name, *numbers = peer.stdout.readline().split()
                    if int(points) == SIDE * SIDE and int(cells) == 2 * (SIDE - 1)**2:
                        break  # Levels of detail came before all of it.
                self.assertEqual((device, attributes, name), ("Liver", "1", "heat"))
                x, y, z = sheet(i).T
                there = numpy.array(numbers[:3 * SIDE * SIDE], dtype=float).reshape(-1, 3)
                self.assertLess(numpy.abs(there - 2 * numpy.stack([x, -z, y], axis=1)).max(), 2 * TOLERANCE, i)
                times.append(float(stamp))
            self.assertEqual({tuple(sorted(f)) for f in numpy.array(numbers[3 * SIDE * SIDE:], dtype=int).reshape(-1, 3)},
                             {tuple(sorted(f)) for f in squares()}, "in the sender's numbers")
            self.assertEqual(times, sorted(set(times)))
            self.assertLess(abs(times[-1] - time.time()), 60, "seconds since 1970")
            self.assertRegex(bridge.end(), r"0 more were too fast; \d+ messages sent, 0 replaced")

    def test_both_versions_of_the_header_are_read_and_written(self):
        read, written = self.origin + "/v2", self.origin + "/v2"
        points = sheet()
        with Bridge("in", read, "--listen", "0", "--up", "y") as bridge, Bridge("out", written + "?rate=raw", "--listen", "0", "--up", "y",
                                                                               "--header", 2) as back:
            sender, receiver = self.connected(bridge.port), self.connected(back.port)
            for i in range(POSES):
                content = polydata(sheet(i), squares())
                if i % 2:  # with meta data of one entry, which nobody reads here
                    meta = struct.pack(">HHHI", 1, 1, 3, 1) + b"kv"
                    body = struct.pack(">HHII", 12, len(meta) - 2, 2, i) + content + meta
                else:
                    body = content
                sender.sendall(header(body, version=1 + i % 2))
                sender.sendall(body)
                while True:
                    version, device, _, points, triangles = parsed(receiver)
                    if len(points) == SIDE * SIDE:
                        break
                self.assertEqual((version, device), (2, "Eigencast"))
                self.assertLess(numpy.abs(points - sheet(i)).max(), TOLERANCE, i)
            self.assertEqual(len(triangles), len(squares()))
            self.assertIn(f"{POSES} surfaces taken, 0 refused", bridge.end())

    def test_what_is_hostile_is_refused_and_the_next_surface_taken(self):
        url, good = self.origin + "/hostile", polydata(sheet(), squares())
        fits = {"a wrong checksum": header(good, crc=1) + good}
        for name, changed in {"points": {"points": 2**32 - 1}, "no points": {"points": 0}, "polygons": {"polygons": 2**32 - 1},
                              "polygons' size": {"polygons_size": 2**32 - 4}, "strips' size": {"strips": 1, "strips_size": 2**32 - 4},
                              "attributes": {"attributes": 2**32 - 1}}.items():
            body = polydata(sheet(), squares(), **changed)
            fits[name] = header(body) + body
        outside = polydata(sheet(), squares() + SIDE * SIDE)
        fits["points that are not there"] = header(outside) + outside
        not_finite = polydata(sheet() * numpy.nan, squares())
        fits["points that are not numbers"] = header(not_finite) + not_finite
        extended = struct.pack(">HHII", 65535, 65535, 2**32 - 1, 0) + good
        fits["an extended header"] = header(extended, version=2) + extended
        ends = {"a body of a terabyte": header(good, size=2**40), "a body of 2**64 - 1": header(good, size=2**64 - 1),
                "version 3": header(good, version=3), "another protocol": b"GET / HTTP/1.1\r\nHost: somewhere.example.org\r\nAccept: */*\r\n\r\n"}
        with Bridge("in", url, "--listen", "0") as bridge, eigencast.Subscriber(url + "?rate=raw", cache_dir="") as subscriber:
            taken = refused = 0
            connection = self.connected(bridge.port)

            def take():
                nonlocal taken
                for _ in range(60):  # one that comes too soon after another is left out
                    connection.sendall(header(good) + good)
                    taken += 1
                    if self.next_whole(subscriber, 1) is not None:
                        return
                self.fail(f"no pose: {subscriber.stats()}")

            take()
            before = bridge.peak_kib()
            for hostile in fits.values():
                connection.sendall(hostile)
                refused += 1
            connection.sendall(header(b"", kind="STATUS", size=1000) + bytes(1000))  # other types are no offence
            connection.sendall(header(good, device="Another") + good)
            take()
            for name, hostile in ends.items():
                connection.sendall(hostile)
                refused += 1
                self.assertEqual(connection.recv(1), b"", name)
                connection = self.connected(bridge.port)
                take()
            for cut in (1, 57, 58, 1000, len(good)):  # a peer that dies within a message
                connection.sendall((header(good) + good)[:cut])
                connection.close()
                connection = self.connected(bridge.port)
                take()
            self.assertLess(bridge.peak_kib() - before, 32_000)
            said = bridge.end()
            self.assertIn(f"{taken} surfaces taken, {refused} refused, 1 of other devices", said)

    def test_a_peer_that_reads_nothing_delays_nobody(self):
        url, n = self.origin + "/slow", 200
        with eigencast.Stream(url, rank=20, max_rate_hz=1e6, cache_dir="") as stream, \
                Bridge("out", url + "?rate=raw", "--listen", "0") as bridge:
            quick, slow = self.connected(bridge.port), socket.socket()
            self.addCleanup(slow.close)
            slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            slow.connect(("127.0.0.1", bridge.port))
            for _ in range(2):
                bridge.until("connected with")
            for i in range(n):
                stream.send(sheet(i / 100), squares())
                while len(parsed(quick)[3]) != SIDE * SIDE:
                    pass
            last = None
            slow.settimeout(2)
            try:
                while True:
                    last, before = parsed(slow)[3], last
                    if before is not None and len(before) == len(last):
                        self.assertGreater(last[:, 0].min(), before[:, 0].min() - TOLERANCE, "in order")
            except TimeoutError:
                pass
            self.assertLess(numpy.abs(last[:, 0] - sheet((n - 1) / 100)[:, 0]).max(), TOLERANCE, "the newest comes in the end")
            self.assertNotIn(" 0 replaced by newer ones", bridge.end())

    def test_usage(self):
        for arguments, says in {("in", "http://127.0.0.1:1/x", "--listen", "x"): "PORT", ("in", "nonsense://x", "--listen", "0"): "URL|http",
                                ("out", "http://127.0.0.1:1/x", "--listen", "1", "--connect", "2"): "excludes",
                                ("out", "http://127.0.0.1:1/x", "--device", "x" * 21): "20 bytes", ("in",): "url"}.items():
            done = subprocess.run([BRIDGE, *arguments], capture_output=True, text=True, timeout=60, check=False)
            self.assertEqual(done.returncode, 2, done)
            self.assertRegex(done.stderr, says)


cases.main(argv=sys.argv[:1])
