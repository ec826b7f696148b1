#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""The Python package against a real broker: what is published arrives, with its scalars and velocities; misuse raises.

Usage: python_test.py BROKER LIBRARY PACKAGE_FOLDER CLIENT. Exits with 77 where numpy is missing.
"""
import gc
import os
import pathlib
import subprocess
import sys
import tempfile
import threading
import time
import unittest

try:
    import numpy
except ImportError:
    print("SKIPPED: numpy is not installed for this interpreter")
    sys.exit(77)

BROKER, os.environ["EIGENCAST_LIBRARY"], PACKAGE, os.environ["EIGENCAST_CLIENT"] = sys.argv[1:5]
sys.dont_write_bytecode = True
sys.path.insert(0, PACKAGE)
import eigencast  # noqa: E402
from eigencast import _library  # noqa: E402


def sheet(side=16):
    y, x = numpy.mgrid[0:side, 0:side].astype(float) / side
    positions = numpy.stack([x.ravel(), y.ravel(), 0.1 * numpy.sin(3 * x.ravel())], axis=1)
    corner = (numpy.arange(side - 1)[:, None] * side + numpy.arange(side - 1)).ravel()
    faces = numpy.concatenate([numpy.stack([corner, corner + 1, corner + side], axis=1),
                               numpy.stack([corner + 1, corner + side + 1, corner + side], axis=1)])
    return positions, faces


class Package(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        port = pathlib.Path(cls.folder.name) / "port"
        cls.broker = subprocess.Popen([BROKER, "--listen", "127.0.0.1:0", "--admin-listen", "127.0.0.1:0", "--port-file", port, "--data-dir",
                                       pathlib.Path(cls.folder.name) / "assets", "--history-streams", "past/**"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        end = time.monotonic() + 60
        while not port.exists() or not port.read_text().endswith("\n"):
            if time.monotonic() > end:
                raise RuntimeError("the broker did not start")
            time.sleep(0.02)
        cls.origin = "ws://127.0.0.1:" + port.read_text().split()[0]
        cls.positions, cls.faces = sheet()
        cls.asset = eigencast.bake(cls.positions, cls.faces, rank=40, cache_dir="")

    @classmethod
    def tearDownClass(cls):
        cls.broker.terminate()
        cls.broker.wait()
        cls.folder.cleanup()

    def watched(self, url, send, enough, **options):
        """Sends until a watcher has a pose that is enough; gives that."""
        with eigencast.Subscriber(url + "?rate=raw", cache_dir="", **options) as subscriber:
            end = time.monotonic() + 30
            while time.monotonic() < end:
                send()
                pose = subscriber.next(timeout=0.03)
                if pose is not None and enough(pose):
                    return pose
            self.fail(f"nothing came: {subscriber.stats()}")

    def assert_refused(self, status, call, *arguments, **named):
        with self.assertRaises(eigencast.Error) as caught:
            call(*arguments, **named)
        self.assertEqual(caught.exception.status, eigencast.Status[status])

    def test_what_is_past_is_sought_stepped_and_left(self):
        url, sent_us, going = self.origin + "/past/sheet", [], threading.Event()
        going.set()

        def pose_of(number):
            return self.positions + [0, 0.002 * number, 0.1 * numpy.sin(0.1 * number)]

        def send():
            with eigencast.Publisher(url, self.asset, error=1e-5) as publisher:
                while going.is_set():
                    sent_us.append(time.time_ns() // 1000)
                    publisher.send(pose_of(len(sent_us) - 1))
                    time.sleep(0.03)

        sender = threading.Thread(target=send)
        sender.start()
        try:
            with eigencast.Subscriber(url + "?rate=raw", cache_dir="") as subscriber:
                end = time.monotonic() + 120

                def next_pose():
                    """Its number, and when that was."""
                    while time.monotonic() < end:
                        pose = subscriber.next(timeout=1)
                        if pose is not None and len(pose.positions) == len(self.positions):
                            points = pose.in_source_order()
                            number = round(float((points - self.positions)[:, 1].mean()) / 0.002)
                            self.assertLess(numpy.abs(points - pose_of(number)).max(), 1e-3)
                            return number, subscriber.past().at_us
                    self.fail(f"nothing came: {subscriber.stats()}, {subscriber.past()}")

                def kept_us():
                    return sum(to_us - from_us for from_us, to_us in subscriber.past().spans)

                first, at_us = next_pose()
                self.assertIsNone(at_us)
                self.assert_refused("NOT_FOUND", subscriber.step)
                for speed in (-1, 0.05, 11, float("nan")):
                    self.assert_refused("INVALID_ARGUMENT", subscriber.seek, ago=1, speed=speed)
                while kept_us() < 3_000_000 and time.monotonic() < end:
                    next_pose()
                wanted_us = subscriber.past().now_us - 2_000_000
                subscriber.seek(at_us=wanted_us, speed=0)
                number, at_us = next_pose()
                self.assertLessEqual(at_us, wanted_us)
                self.assertLessEqual(sent_us[number], at_us + 50_000, "the broker has it later than who sends it")
                subscriber.step()
                later, later_us = next_pose()
                self.assertGreater((later, later_us), (number, at_us))
                subscriber.step(forward=False)
                self.assertEqual(next_pose(), (number, at_us))
                self.assertIsNone(subscriber.next(timeout=0.3), "at speed 0 one pose comes")
                subscriber.seek(ago=2)
                numbers = [next_pose()[0] for _ in range(5)]
                self.assertEqual(numbers, sorted(set(numbers)))
                self.assertIsNotNone(subscriber.past().at_us)
                subscriber.live()
                number, at_us = next_pose()
                self.assertIsNone(at_us)
                self.assertGreater(number, numbers[-1])
            with eigencast.Subscriber(self.origin + "/unkept", cache_dir="") as subscriber:
                subscriber.seek(ago=1)
                with self.assertRaisesRegex(eigencast.Error, r"\(not-found\)") as caught:
                    while time.monotonic() < end:
                        subscriber.next(timeout=1)
                self.assertEqual(caught.exception.status, eigencast.Status.REFUSED)
        finally:
            going.clear()
            sender.join()

    def test_an_asset_says_what_it_is(self):
        self.assertEqual((self.asset.vertex_count, self.asset.face_count, self.asset.rank), (256, 450, 40))
        self.assertRegex(self.asset.id, "^[0-9a-f]{64}$")
        self.assertFalse(self.asset.from_cache)

    def test_a_rank_is_chosen_for_a_wish(self):
        poses = numpy.stack([self.positions * [1, 1 + 0.01 * t, 1] for t in range(12)])  # affine: the fewest columns do
        for wish in ({}, {"quality": 2}):
            with self.subTest(wish=wish):
                self.assertEqual(eigencast.bake(self.positions, self.faces, cache_dir="", poses=poses, **wish).rank, 25)
        for wish in ({"target_error": 1e-2}, {"bitrate": 20_000}):
            self.assertGreaterEqual(eigencast.bake(self.positions, self.faces, cache_dir="", poses=poses, **wish).rank, 25)
        self.assertGreaterEqual(eigencast.bake(self.positions, self.faces, cache_dir="", quality=0.5).rank, 25)
        self.assert_refused("INVALID_ARGUMENT", eigencast.bake, self.positions, self.faces, cache_dir="", rank=40, quality=1)
        self.assert_refused("INVALID_ARGUMENT", eigencast.bake, self.positions, self.faces, cache_dir="", quality=-1)
        with self.assertRaisesRegex(ValueError, r"\(T, 256, 3\)"):
            eigencast.bake(self.positions, self.faces, cache_dir="", poses=poses[:, 1:])

    def test_bases_of_a_known_motion_hold_it(self):
        x = self.positions[:, 0]
        poses = numpy.stack([self.positions + 0.2 * numpy.outer(numpy.sin(t / 3) * x ** 3 + numpy.cos(t / 3) * x ** 4, [0, 0, 1]) for t in range(12)])
        cage = numpy.stack([(1 - x) ** 4, 4 * x * (1 - x) ** 3, 6 * x ** 2 * (1 - x) ** 2, 4 * x ** 3 * (1 - x), x ** 4], axis=1)  # of Bernstein
        for basis, given in (("pca", {"poses": poses}), ("cage", {"columns": cage}), ("rig", {"columns": cage})):
            with self.subTest(basis=basis):
                asset, url = eigencast.bake(self.positions, self.faces, basis=basis, cache_dir="", **given), f"{self.origin}/{basis}"
                self.assertLess(asset.rank, 12)
                with eigencast.Publisher(url, asset, error=1e-5) as publisher:
                    for pose in poses[::4]:
                        self.watched(url, lambda: publisher.send(pose), lambda p: len(p.positions) == 256 and numpy.abs(p.in_source_order() - pose).max() < 1e-3)
            self.assert_refused("INVALID_ARGUMENT", eigencast.bake, self.positions, self.faces, basis=basis, cache_dir="")
        for wrong, said in ((cage[1:], r"\(256, k\)"), (cage * numpy.nan, "finite"), (numpy.ones((256, 3000)), "2048")):
            with self.assertRaisesRegex((ValueError, eigencast.Error), said):
                eigencast.bake(self.positions, self.faces, basis="cage", cache_dir="", columns=wrong)
        plain, frames = (eigencast.bake(self.positions, self.faces, basis="harmonic", rank=30, cache_dir="", detail=detail).id for detail in ("none", "frames"))
        self.assertNotEqual(plain, frames)
        self.assertEqual(frames, eigencast.bake(self.positions, self.faces, basis="harmonic", rank=30, cache_dir="").id)
        self.assert_refused("INVALID_ARGUMENT", eigencast.bake, self.positions, self.faces, basis="harmonic", cache_dir="", detail="much")

    def test_an_asset_is_saved_and_loaded(self):
        folder = pathlib.Path(self.folder.name) / "saved"
        self.asset.save(folder)
        loaded = eigencast.load(folder, self.asset.id)
        self.assertEqual((loaded.id, loaded.vertex_count, loaded.rank), (self.asset.id, 256, 40))
        with eigencast.Publisher(self.origin + "/loaded", loaded) as publisher:
            pose = self.watched(self.origin + "/loaded", lambda: publisher.send(self.positions), lambda p: len(p.positions) == 256)
        self.assertLess(numpy.abs(pose.in_source_order() - self.positions).max(), 0.02)
        self.assert_refused("NOT_FOUND", eigencast.load, folder, 64 * "0")
        self.assert_refused("INVALID_ARGUMENT", eigencast.load, folder, "latest")
        damaged = next(file for file in folder.iterdir() if file.name != self.asset.id)
        damaged.write_bytes(damaged.read_bytes()[:-1] + b"!")
        with self.assertRaises(eigencast.Error) as caught:
            eigencast.load(folder, self.asset.id)
        self.assertEqual(caught.exception.status, eigencast.Status.CORRUPT)
        damaged.unlink()
        with self.assertRaisesRegex(eigencast.Error, damaged.name):
            eigencast.load(folder, self.asset.id)

    def test_a_watcher_keeps_to_its_budget_of_vertices(self):
        url = "http" + self.origin[2:] + "/budget"  # means the same as ws
        with eigencast.Publisher(url, self.asset) as publisher:
            pose = self.watched(url, lambda: publisher.send(self.positions), lambda p: len(p.positions) >= 100, max_vertices=100)
            self.assertEqual(len(pose.positions), 100)
            self.assertLess(pose.triangles.max(), 100)
            coarsest = self.watched(url, lambda: publisher.send(self.positions), lambda p: True, max_vertices=1)
            self.assertGreater(len(coarsest.positions), 1)
            self.assertLess(len(coarsest.positions), 100)

    def test_what_is_sent_arrives_in_place_and_order(self):
        bent = self.positions + numpy.stack([0 * self.positions[:, 0], 0 * self.positions[:, 0], self.positions[:, 0] ** 2], axis=1)
        with eigencast.Publisher(self.origin + "/bent", self.asset) as publisher:
            pose = self.watched(self.origin + "/bent", lambda: publisher.send(bent), lambda p: len(p.positions) == 256)
            self.assertGreater(publisher.stats().frames_sent, 0)
            self.assertTrue(publisher.stats().live)
        self.assertLess(numpy.abs(pose.in_source_order() - bent).max(), 0.02)
        self.assertEqual(pose.triangles.shape, (450, 3))
        numpy.testing.assert_allclose(numpy.linalg.norm(pose.normals, axis=1), 1, atol=1e-5)
        self.assertEqual(pose.scalars.shape, (256, 0))
        self.assertIsNone(pose.velocities)
        self.assertFalse(pose.interpolated)

    def test_scalars_and_velocities_ride_along(self):
        stress = numpy.stack([self.positions[:, 0], 1 - self.positions[:, 1], 0.5 + 0 * self.positions[:, 0], self.positions[:, 0] ** 2], axis=1)
        velocity = numpy.stack([2 + 0 * self.positions[:, 0], 0 * self.positions[:, 0], -self.positions[:, 1]], axis=1)
        scalars = ["across", eigencast.Scalar("along", "kPa", 0, 1), "half", eigencast.Scalar("bend", low=0, high=1, error=1e-4)]
        with eigencast.Publisher(self.origin + "/stress", self.asset, scalars=scalars, velocities=True) as publisher:
            pose = self.watched(self.origin + "/stress", lambda: publisher.send(self.positions, velocities=velocity, scalars=stress),
                                lambda p: len(p.positions) == 256)
            with self.assertRaisesRegex(ValueError, "scalars"):
                publisher.send(self.positions, velocities=velocity)
            with self.assertRaisesRegex(ValueError, r"scalars.*\(256, 4\)"):
                publisher.send(self.positions, velocities=velocity, scalars=stress[:, :2])
        self.assertEqual(pose.scalars.shape, (256, 4))
        self.assertLess(numpy.abs(pose.scalars - stress[pose.source_vertex]).max(), 0.05)
        self.assertEqual([(s.name, s.unit, s.low, s.high) for s in pose.scalar_info],
                         [("across", "", 0, 0), ("along", "kPa", 0, 1), ("half", "", 0, 0), ("bend", "", 0, 1)])
        # Coded as the movement in a quarter of a key interval, within the same error as positions.
        off = pose.velocities - velocity[pose.source_vertex]
        self.assertLess(numpy.sqrt((off ** 2).sum(axis=1).mean()), 0.001 * numpy.sqrt(2) * 4 * 30 * 2)
        self.assertLess(numpy.abs(pose.in_source_order() - self.positions).max(), 0.02)

    def test_colours_and_textures_arrive_with_their_corners(self):
        image = b"\x89PNG\r\n\x1a\n" + bytes(range(200))  # nobody decodes it on the way
        uv = self.positions[self.faces][:, :, :2] + numpy.where(numpy.arange(450) % 2, 2.0, 0.0)[:, None, None]  # a seam along every edge
        uv[7] = numpy.nan
        colours = (255 * self.positions).clip(0, 255).astype(numpy.uint8)
        asset = eigencast.bake(self.positions, self.faces, rank=40, cache_dir="", image=image, corner_uv=uv, vertex_colours=colours)
        url = self.origin + "/painted"
        with eigencast.Publisher(url, asset) as publisher, eigencast.Subscriber(url + "?rate=raw", cache_dir="") as subscriber:
            pose, end = None, time.monotonic() + 30
            while time.monotonic() < end and (pose is None or pose.corner_uv is None):
                publisher.send(self.positions)
                pose = subscriber.next(timeout=0.03) or pose
            self.assertEqual(subscriber.image(), image)
        numpy.testing.assert_array_equal(pose.vertex_colours, colours[pose.source_vertex])
        # Each triangle is one of the source's, with its corners in some turn.
        given = {tuple(sorted(face)): dict(zip(face, uvs)) for face, uvs in zip(self.faces.tolist(), uv)}
        for triangle, uvs in zip(pose.source_vertex[pose.triangles].tolist(), pose.corner_uv):
            for vertex, found in zip(triangle, uvs):
                numpy.testing.assert_allclose(found, given[tuple(sorted(triangle))][vertex], atol=1e-4)
        with eigencast.Publisher(url + "2", self.asset) as publisher:
            plain = self.watched(url + "2", lambda: publisher.send(self.positions), lambda p: len(p.positions) == 256)
        self.assertIsNone(plain.vertex_colours)
        self.assertIsNone(plain.corner_uv)

    def test_an_appearance_that_cannot_be_meant_is_refused(self):
        png, uv = b"\x89PNG\r\n\x1a\n0", self.positions[:, :2]
        for wrong, status in (({"image": png}, "INVALID_ARGUMENT"), ({"vertex_uv": uv}, "INVALID_ARGUMENT"),
                              ({"image": b"GIF89a", "vertex_uv": uv}, "UNSUPPORTED"), ({"image": b"", "vertex_uv": uv}, "NOT_FOUND"),
                              ({"image": png, "vertex_uv": uv, "corner_uv": uv[self.faces]}, "INVALID_ARGUMENT")):
            with self.subTest(wrong=sorted(wrong)):
                self.assert_refused(status, eigencast.bake, self.positions, self.faces, rank=40, cache_dir="", **wrong)
        self.assert_refused("INVALID_ARGUMENT", eigencast.bake, self.positions, rank=20, cache_dir="", image=png, vertex_uv=uv)
        for wrong, said in (({"vertex_colours": self.positions}, "vertex_colours"), ({"vertex_colours": uv}, r"\(256, 3\)"),
                            ({"vertex_colours": 300 + 0 * self.faces[:256]}, "0..255"), ({"vertex_uv": self.positions}, r"\(256, 2\)")):
            with self.assertRaisesRegex(ValueError, said):
                eigencast.bake(self.positions, self.faces, rank=40, cache_dir="", **wrong)

    def test_a_share_of_vertices_is_enough(self):
        with eigencast.Publisher(self.origin + "/coarse", self.asset) as publisher:
            pose = self.watched(self.origin + "/coarse", lambda: publisher.send(self.positions), lambda p: True, detail=0.25)
        self.assertLess(len(pose.positions), 100)
        self.assertLess(pose.triangles.max(), len(pose.positions))

    def test_a_point_cloud_has_no_triangles(self):
        cloud = eigencast.bake(self.positions, rank=20, cache_dir="")
        with eigencast.Publisher(self.origin + "/cloud", cloud) as publisher:
            pose = self.watched(self.origin + "/cloud", lambda: publisher.send(self.positions), lambda p: len(p.positions) == 256)
        self.assertEqual(pose.triangles.shape, (0, 3))
        self.assertIsNone(pose.normals)

    def test_without_a_broker_it_never_waits(self):
        with eigencast.Publisher("ws://127.0.0.1:9/nobody", self.asset) as publisher:
            self.assertIs(publisher.send(self.positions), eigencast.Sent.DISCONNECTED)
            self.assertFalse(publisher.wait_live(timeout=0))
            stats = publisher.stats()
            self.assertEqual((stats.frames_dropped, stats.dropped_disconnected), (1, 1))
            self.assertIn("127.0.0.1:9", stats.detail)
        with eigencast.Subscriber("ws://127.0.0.1:9/nobody", cache_dir="") as subscriber:
            self.assertIsNone(subscriber.next(timeout=0.01))

    def test_poses_after_wait_live_are_sent_and_drops_are_counted_by_reason(self):
        with eigencast.Publisher(self.origin + "/waited", self.asset) as publisher:
            self.assertTrue(publisher.wait_live(timeout=60))
            self.assertIs(publisher.send(self.positions, 1_000_000), eigencast.Sent.SENT)
            self.assertIs(publisher.send(self.positions, 1_000_000), eigencast.Sent.DROPPED)
            stats = publisher.stats()
        self.assertEqual((stats.frames_sent, stats.frames_dropped, stats.dropped_time), (1, 1, 1))
        self.assertEqual((stats.dropped_disconnected, stats.dropped_behind, stats.dropped_unusable), (0, 0, 0))

    def test_a_stream_bakes_and_publishes_every_pose_in_order(self):
        url, x = self.origin + "/streamed", self.positions[:, 0]
        shifted = [self.positions + [0.1 * i, 0, 0] for i in range(21)]
        with eigencast.Stream(url, rank=40, scalars={"stress": (0, 2e8, "Pa")}, max_rate_hz=float("inf"), cache_dir="") as stream, \
                eigencast.Subscriber(url + "?rate=raw", cache_dir="") as subscriber:
            with self.assertRaisesRegex(eigencast.Error, "first pose"):
                stream.wait_live(timeout=0)
            came = []
            for i, points in enumerate(shifted):
                taken = stream.send(points, self.faces, scalars={"stress": 1e8 * x}, time_s=1.8e9 + i / 30)  # as clocks of Unix say it
                self.assertIs(taken, eigencast.Taken.SENT if i else eigencast.Taken.BAKING)
                end = time.monotonic() + 60
                while len(came) <= i and time.monotonic() < end:
                    pose = subscriber.next(timeout=0.05)
                    if pose is not None and len(pose.positions) == 256:
                        came.append(pose)
                self.assertEqual(len(came), i + 1, stream.stats)
            stats = stream.stats
            self.assertEqual((stats.poses_taken, stats.poses_sent, stats.bakes), (21, 21, 1))
            self.assertTrue(stats.live)
        for sent, pose in zip(shifted, came):
            self.assertLess(numpy.abs(pose.in_source_order() - sent).max(), 0.02)
        self.assertEqual([(s.name, s.unit) for s in came[-1].scalar_info], [("stress", "Pa")])
        self.assertLess(numpy.abs(came[-1].scalars[:, 0] - 1e8 * x[came[-1].source_vertex]).max(), 2e6)

    def test_ranges_of_scalars_that_nobody_states_are_learnt(self):
        url, x = self.origin + "/learnt", self.positions[:, 0]
        with eigencast.Stream(url, rank=40, scalars={"pressure": None, "strain": None}, max_rate_hz=float("inf"), cache_dir="") as stream:
            for pressure, strain in ((0, 0), (1e-20, 0), (1e-3, 0), (1e5, 1e-4), (2e5, 1e-4)):  # at rest; noise; then in Pa
                pose = self.watched(url, lambda: stream.send(self.positions, self.faces, scalars={"pressure": pressure * x, "strain": strain * x}),
                                    lambda p: len(p.positions) == 256 and abs(p.scalars[:, 0].max() - pressure * x.max()) <= 0.02 * pressure + 1e-9)
                self.assertLess(numpy.abs(pose.scalars - numpy.outer(x, [pressure, strain])[pose.source_vertex]).max(axis=0)[1], 0.02 * strain + 1e-6)
            low, high = pose.scalar_info[0].low, pose.scalar_info[0].high
            self.assertEqual((stream.stats.poses_dropped, stream.stats.bakes), (0, 1))
        self.assertLessEqual(low, 0)
        self.assertAlmostEqual(high, 1e5 * x.max(), delta=1)

    def test_a_stream_knows_other_faces_by_their_content(self):
        with eigencast.Stream(self.origin + "/faces", rank=20, max_rate_hz=1e6, cache_dir="") as stream:
            faces = self.faces.copy()
            stream.send(self.positions, faces)
            self.assertTrue(stream.wait_live())
            self.assertIs(stream.send(self.positions), eigencast.Taken.SENT)
            self.assertIs(stream.send(self.positions, faces.astype(numpy.int32)), eigencast.Taken.SENT)
            faces[:2] = faces[1::-1]  # in place, and as many
            self.assertIs(stream.send(self.positions, faces), eigencast.Taken.BAKING)
            self.assertTrue(stream.wait_live())
            self.assertIs(stream.send(self.positions, faces, topology="a"), eigencast.Taken.SENT)
            self.assertIs(stream.send(self.positions, "not looked at", topology="a"), eigencast.Taken.SENT)
            with self.assertRaisesRegex(eigencast.Error, "faces"):
                stream.send(self.positions[:100])
            self.assertEqual(stream.stats.bakes, 2)
        with eigencast.Stream(self.origin + "/raises", rank=20, on_topology="raise", cache_dir="") as stream:
            stream.send(self.positions, self.faces)
            self.assert_refused("INVALID_ARGUMENT", stream.send, self.positions, self.faces[::-1])
            with self.assertRaisesRegex(ValueError, "scalars"):
                stream.send(self.positions, scalars={"heat": self.positions[:, 0]})

    def test_what_a_stream_cannot_mean_is_refused_and_it_goes_on(self):
        points, faces, heat = self.positions, self.faces, self.positions[:, 0]
        with eigencast.Stream(self.origin + "/odd", rank=20, scalars={"heat": None}, cache_dir="") as stream:
            for wrong, said in (({"points": points.T}, r"\(n, 3\)"), ({"points": points + numpy.inf}, "finite"), ({"points": points[:0], "scalars": {"heat": heat[:0]}}, "points"),
                                ({"faces": faces[:, :2]}, "corners"), ({"faces": faces + 1}, "256"), ({"faces": faces.astype(float)}, "whole numbers"),
                                ({"faces": None, "offsets": [0, 3]}, "faces"), ({"scalars": {"heat": heat[1:]}}, r"heat.*256"),
                                ({"scalars": {"heat": numpy.where(heat > 0.5, numpy.nan, heat)}}, "heat of point 9 "), ({"scalars": 1.0}, r"\(256, 1\)"),
                                ({"time_s": numpy.inf}, "time")):
                with self.subTest(wrong=wrong.keys()), self.assertRaisesRegex((ValueError, eigencast.Error), said):
                    stream.send(**{"points": points, "faces": faces, "scalars": {"heat": heat}, **wrong})
            strided = numpy.asfortranarray(numpy.repeat(points, 2, axis=0)).astype(object)[::2]
            self.assertIs(stream.send(strided, faces[:, ::-1][:, ::-1].astype(numpy.int16), scalars={"heat": heat}), eigencast.Taken.BAKING)
            self.assertTrue(stream.wait_live())
            with self.assertRaises(eigencast.Error):
                stream.send(points, scalars={"heat": heat * numpy.nan})
            self.assertIs(stream.send(points, scalars={"heat": heat}), eigencast.Taken.SENT)
        for wrong in ({"scale": 0}, {"rank": -1}, {"scalars": {"a": 5}}):
            with self.subTest(wrong=wrong), self.assertRaises(ValueError):
                eigencast.Stream(self.origin + "/odd", **wrong)

    def test_a_stream_survives_fork_exceptions_and_the_end_of_the_interpreter(self):
        program = '''
import os, sys, numpy, eigencast
stream = eigencast.Stream(sys.argv[1], rank=20, max_rate_hz=1e6, cache_dir="")
points = numpy.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], dtype=float)
faces = [[0, 1, 2], [0, 1, 3], [1, 2, 4], [0, 2, 3]]
stream.send(points, faces)
assert stream.wait_live()
watched = eigencast.Subscriber(sys.argv[1], cache_dir="")
publisher = eigencast.Publisher(sys.argv[1] + "-too", eigencast.bake(points, faces, rank=5, cache_dir=""))
child = os.fork()
if child == 0:
    try:
        stream.send(points)
    except eigencast.Error as error:
        if error.status is eigencast.Status.UNSUPPORTED:
            sys.exit(7)  # All ends as in any program: handlers, objects, what the library keeps.
    os._exit(2)
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
watched.close()
publisher.close()
try:
    stream.send(points * numpy.nan)
except eigencast.Error:
    assert stream.send(points) is eigencast.Taken.SENT
stream.send(points + 5)
'''
        url = self.origin + "/ended"
        with eigencast.Subscriber(url + "?rate=raw", cache_dir="") as subscriber:
            done = subprocess.run([sys.executable, "-c", program, url], env={**os.environ, "PYTHONPATH": PACKAGE}, timeout=100, check=False)
            self.assertEqual(done.returncode, 0)
            last, end = None, time.monotonic() + 60
            while time.monotonic() < end and (last is None or last.positions.min() < 4):
                last = subscriber.next(timeout=0.05) or last
        self.assertGreater(last.positions.min(), 4, "what waited was sent before the interpreter ended")

    def test_watched_poses_are_views(self):
        url = self.origin + "/viewed"
        with eigencast.Stream(url, rank=40, cache_dir="") as stream:
            stream.send(self.positions, self.faces)
            for pose in eigencast.watch(url + "?rate=raw", cache_dir=""):
                if len(pose.points) == 256 and len(pose.faces) == 450:
                    break
                stream.send(self.positions)
            self.assertFalse(pose.points.flags.owndata)
            self.assertLess(numpy.abs(pose.in_source_order() - self.positions).max(), 0.02)
            pose = None

    def test_a_picture_is_of_the_present_pose(self):
        url = self.origin + "/drawn"
        with eigencast.Stream(url, rank=40, cache_dir="") as stream:
            stream.send(self.positions, self.faces)
            self.assertTrue(stream.wait_live())
            self.watched(url, lambda: None, lambda pose: True)
            png = eigencast.picture(url, (320, 200))
            self.assertEqual((png[:8], png[16:24]), (b"\x89PNG\r\n\x1a\n", (320).to_bytes(4, "big") + (200).to_bytes(4, "big")))
            self.assertNotEqual(eigencast.picture(url, (320, 200), view="top"), png)
            bent = self.positions.copy()
            bent[:, 2] += self.positions[:, 0] ** 2
            stream.send(bent)
            self.watched(url, lambda: None, lambda pose: numpy.abs(pose.positions[:, 2]).max() > 0.5)
            self.assertNotEqual(eigencast.picture(url, (320, 200)), png)

    def test_a_picture_that_cannot_be_drawn_says_why(self):
        self.assert_refused("NOT_FOUND", eigencast.picture, self.origin + "/nobody", timeout=0.1)
        self.assert_refused("INVALID_ARGUMENT", eigencast.picture, self.origin + "/nobody", size=(0, 10))
        self.assert_refused("INVALID_ARGUMENT", eigencast.picture, self.origin + "/nobody", view="inside")
        self.assert_refused("INVALID_ARGUMENT", eigencast.picture, "--version")
        client = os.environ.pop("EIGENCAST_CLIENT")
        path, os.environ["PATH"] = os.environ["PATH"], ""
        try:
            with self.assertRaisesRegex(eigencast.Error, "eigencast-tools"):
                eigencast.picture(self.origin + "/nobody")
        finally:
            os.environ["EIGENCAST_CLIENT"], os.environ["PATH"] = client, path

    def test_progress_is_told_and_can_end_the_bake(self):
        reports = []
        eigencast.bake(self.positions, self.faces, rank=30, cache_dir="", progress=lambda fraction, stage: reports.append((fraction, stage)))
        self.assertTrue(reports and all(0 <= fraction <= 1 and stage for fraction, stage in reports))

        def enough(*_):
            raise KeyboardInterrupt

        with self.assertRaises(KeyboardInterrupt):
            eigencast.bake(self.positions, self.faces, rank=30, cache_dir="", progress=enough)

    def test_a_triangle_soup_is_told_of_and_welded(self):
        soup, loose = self.positions[self.faces].reshape(-1, 3), numpy.arange(3 * len(self.faces)).reshape(-1, 3)
        with self.assertWarnsRegex(UserWarning, "mesh.weld"):
            self.assertTrue(eigencast.bake(soup, loose, rank=20, cache_dir="").loose_faces)
        vertices, faces = eigencast.mesh.weld(soup, loose)
        self.assertEqual((len(vertices), len(faces)), (256, 450))
        numpy.testing.assert_array_equal(soup[vertices][faces], soup[loose])
        self.assertFalse(eigencast.bake(soup[vertices], faces, rank=20, cache_dir="").loose_faces)

    def test_solids_and_polygons_become_triangles(self):
        corners = numpy.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1], [5, 5, 5]], dtype=float)
        vertices, faces = eigencast.mesh.boundary(corners, [range(8)], "hexahedron")
        numpy.testing.assert_array_equal(vertices, range(8))
        a, b, c = (corners[vertices][faces[:, k]] for k in range(3))
        self.assertAlmostEqual((a * numpy.cross(b, c)).sum() / 6, 1.0)
        numpy.testing.assert_array_equal(eigencast.mesh.triangles([0, 1, 2, 3, 4, 5, 6], [0, 4, 7]), [[0, 1, 2], [0, 2, 3], [4, 5, 6]])
        self.assert_refused("INVALID_ARGUMENT", eigencast.mesh.triangles, [0, 1, 2], [0, 4])
        self.assert_refused("INVALID_ARGUMENT", eigencast.mesh.boundary, corners, [range(8)], "brick")
        with self.assertRaisesRegex(ValueError, "cells"):
            eigencast.mesh.boundary(corners, [[-1, 0, 1, 2]], "tetra")

    def test_misuse_raises_and_says_why(self):
        with self.assertRaisesRegex(ValueError, r"\(n, 3\)"):
            eigencast.bake(self.positions[:, :2], self.faces)
        with self.assertRaisesRegex(ValueError, "255"):
            eigencast.bake(self.positions, self.faces - 1)
        with self.assertRaises(eigencast.Error) as caught:
            eigencast.Subscriber("not a url")
        self.assertEqual(caught.exception.status, eigencast.Status.INVALID_ARGUMENT)
        with self.assertRaises(eigencast.Error):
            eigencast.Publisher(self.origin + "/many", self.asset, scalars=[f"s{i}" for i in range(11)])
        with self.assertRaises(eigencast.Error):
            eigencast.Publisher(self.origin + "/same", self.asset, scalars=["a", "a"])
        publisher = eigencast.Publisher(self.origin + "/closed", self.asset)
        publisher.close()
        with self.assertRaisesRegex(ValueError, "closed"):
            publisher.send(self.positions)
        with eigencast.Publisher(self.origin + "/nan", self.asset) as publisher:
            with self.assertRaises(eigencast.Error):
                publisher.send(self.positions * numpy.nan)

    def test_objects_that_nobody_refers_to_are_released(self):
        for _ in range(3):
            eigencast.Publisher(self.origin + "/dropped", self.asset)
        gc.collect()

    def test_structs_are_as_long_as_the_library_says(self):
        """The library writes as many bytes as both sides know, and gives the caller's length back."""
        info = _library.AssetInfo()
        _library.check(_library.LIBRARY.ec_asset_get_info(self.asset._open(), info))
        self.assertEqual(info.struct_size, _library.ctypes.sizeof(info))


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
