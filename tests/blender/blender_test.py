#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""The Blender add-on outside Blender: a stub of the parts of its API that the add-on uses, and a program in place of
eigencast-sender that keeps what it is given. What a stub cannot show: that Blender itself behaves as the stub does.
Usage: blender_test.py ADDON.py
"""
import importlib.util
import pathlib
import struct
import sys
import tempfile
import time
import types
import unittest

try:
    import numpy
except ImportError:
    print("SKIPPED: needs numpy, which Blender brings along")
    sys.exit(77)

FAKE_SENDER = """#!/usr/bin/env python3
import pathlib, shutil, sys, time
folder = pathlib.Path(__file__).parent
run = len(list(folder.glob("arguments-*")))
arguments = sys.argv[1:]
shutil.copy(arguments[arguments.index("--mesh") + 1], folder / f"mesh-{run}")
(folder / f"arguments-{run}").write_text("\\n".join(arguments))
if (folder / "stall").exists():
    time.sleep(60)
with open(folder / f"poses-{run}", "wb", buffering=0) as out:
    while True:
        data = sys.stdin.buffer.read1(65536)
        if not data:
            break
        out.write(data)
"""


def make_bpy():
    """As much of Blender as the add-on touches."""
    bpy = types.ModuleType("bpy")
    bpy.types = types.SimpleNamespace(Operator=type("Operator", (), {}), Panel=type("Panel", (), {}),
                                      PropertyGroup=type("PropertyGroup", (), {}), Scene=type("Scene", (), {}))
    bpy.props = types.SimpleNamespace(StringProperty=lambda **given: given, PointerProperty=lambda **given: given)
    bpy.registered = []
    bpy.utils = types.SimpleNamespace(register_class=bpy.registered.append, unregister_class=bpy.registered.remove)
    bpy.app = types.SimpleNamespace(handlers=types.SimpleNamespace(frame_change_post=[], depsgraph_update_post=[]))
    bpy.context = types.SimpleNamespace(evaluated_depsgraph_get=lambda: "depsgraph")
    return bpy


class Collection(list):
    """Something with foreach_get, as Blender's collections have it."""

    def foreach_get(self, name, into):
        into[:] = numpy.array([getattr(each, name) for each in self]).reshape(-1)


class FakeObject:
    """An object whose mesh is a tetrahedron (or more vertices), `height` high."""
    type = "MESH"
    name = "Tetra"

    def __init__(self):
        self.height, self.extra, self.live_meshes = 1.0, 0, 0
        self.matrix_world = [[2, 0, 0, 10], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]]

    def evaluated_get(self, depsgraph):
        assert depsgraph == "depsgraph"
        return self

    def to_mesh(self):
        self.live_meshes += 1
        points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, self.height)] + [(5, 5, 5)] * self.extra
        mesh = types.SimpleNamespace(vertices=Collection(types.SimpleNamespace(co=p) for p in points), loop_triangles=Collection())
        faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
        mesh.calc_loop_triangles = lambda: mesh.loop_triangles.extend(types.SimpleNamespace(vertices=f) for f in faces)
        return mesh

    def to_mesh_clear(self):
        self.live_meshes -= 1


def expected(height, extra=0):
    """World space (twice as large, 10 to the right), then y up."""
    points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, height)] + [(5, 5, 5)] * extra
    return [(2 * x + 10, 2 * z, -2 * y) for x, y, z in points]


class AddOn(unittest.TestCase):
    def setUp(self):
        self.folder_keeper = tempfile.TemporaryDirectory()
        self.folder = pathlib.Path(self.folder_keeper.name)
        self.program = self.folder / "fake-sender"
        self.program.write_text(FAKE_SENDER)
        self.program.chmod(0o755)
        self.bpy = sys.modules["bpy"] = make_bpy()
        spec = importlib.util.spec_from_file_location("addon", ADDON)
        self.addon = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(self.addon)
        self.addon.register()
        self.object = FakeObject()
        self.scene = types.SimpleNamespace(objects={"Tetra": self.object},
                                           eigencast=types.SimpleNamespace(program=str(self.program), url="ws://here/live"))
        self.context = types.SimpleNamespace(scene=self.scene, active_object=self.object, evaluated_depsgraph_get=lambda: "depsgraph")
        self.reports = []

    def tearDown(self):
        self.addon.session.stop()
        self.folder_keeper.cleanup()

    def operate(self, operator):
        made = operator()
        made.report = lambda kind, text: self.reports.append(text)
        return made.execute(self.context)

    def change(self):
        for handler in self.bpy.app.handlers.frame_change_post:
            handler(self.scene, "depsgraph")

    def eventually(self, condition):
        end = time.monotonic() + 60
        while not condition():
            self.assertLess(time.monotonic(), end, "it did not happen")
            time.sleep(0.01)

    def poses(self, run, vertices):
        """The (time, positions) that run number `run` has received whole."""
        path = self.folder / f"poses-{run}"
        data = path.read_bytes() if path.exists() else b""
        if len(data) < 16:
            return []
        self.assertEqual(data[:16], b"ECPOSES1" + struct.pack("<II", 1, vertices))
        size = 8 + 12 * vertices
        found = []
        for at in range(16, len(data) - size + 1, size):
            values = struct.unpack(f"<d{3 * vertices}f", data[at:at + size])
            found.append((values[0], [values[1 + 3 * i:4 + 3 * i] for i in range(vertices)]))
        return found

    def test_streams_evaluated_poses_in_order(self):
        self.assertEqual(self.operate(self.addon.EIGENCAST_OT_start), {"FINISHED"})
        self.eventually(lambda: len(self.poses(0, 4)) == 1)
        for count, height in enumerate([2.0, 3.0, 4.0], 2):
            self.object.height = height
            self.change()
            self.eventually(lambda: len(self.poses(0, 4)) == count)
        received = self.poses(0, 4)
        self.assertEqual([p for _, p in received], [expected(h) for h in (1.0, 2.0, 3.0, 4.0)])
        self.assertEqual([t for t, _ in received], sorted({t for t, _ in received}))
        arguments = (self.folder / "arguments-0").read_text().split("\n")
        self.assertIn("pipe", arguments)
        self.assertEqual(arguments[arguments.index("--to") + 1], "ws://here/live")
        lines = (self.folder / "mesh-0").read_text().split("\n")
        rest = [tuple(map(float, line.split()[1:])) for line in lines if line.startswith("v ")]
        self.assertEqual(rest, expected(1.0))
        self.assertEqual([line for line in lines if line.startswith("f ")], ["f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4"])
        self.assertEqual(self.object.live_meshes, 0, "every mesh that was made was cleared")

    def test_another_topology_starts_another_surface(self):
        self.operate(self.addon.EIGENCAST_OT_start)
        self.eventually(lambda: len(self.poses(0, 4)) == 1)
        self.object.extra = 2
        self.change()
        self.eventually(lambda: len(self.poses(1, 6)) == 1)
        self.assertEqual(self.poses(1, 6)[0][1], expected(1.0, 2))

    def test_blender_never_waits_for_a_stuck_sender(self):
        (self.folder / "stall").touch()
        self.object.extra = 50_000
        self.operate(self.addon.EIGENCAST_OT_start)
        for _ in range(5):
            self.change()
        stream = self.addon.session.stream
        self.assertGreaterEqual(stream.replaced, 3, "the newest pose replaces the one that waits")
        self.addon.session.stop()
        self.assertFalse(stream.is_running())

    def test_a_missing_program_is_reported_and_nothing_runs(self):
        self.scene.eigencast.program = "no-such-program"
        self.assertEqual(self.operate(self.addon.EIGENCAST_OT_start), {"CANCELLED"})
        self.assertIn("no-such-program", self.reports[0])
        self.assertIsNone(self.addon.session.stream)

    def test_stop_and_unregister_leave_nothing_behind(self):
        self.operate(self.addon.EIGENCAST_OT_start)
        stream = self.addon.session.stream
        self.assertTrue(self.addon.EIGENCAST_OT_stop.poll(self.context))
        self.operate(self.addon.EIGENCAST_OT_stop)
        self.assertFalse(stream.is_running())
        self.change()
        self.addon.unregister()
        self.assertEqual(self.bpy.registered, [])
        self.assertEqual(self.bpy.app.handlers.frame_change_post, [])
        self.assertEqual(self.bpy.app.handlers.depsgraph_update_post, [])


if __name__ == "__main__":
    ADDON = sys.argv.pop(1)
    unittest.main()
