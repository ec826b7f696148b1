#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Files that eigencast-sender exports, read back by a glTF validator, three.js, Blender and VTK, and compared with the exact poses.

exports_test.py BUILD_FOLDER SOURCE_FOLDER      a reader that is missing is a skip
"""
import pathlib
import subprocess
import sys
import tempfile
import unittest

import numpy

BUILD, SOURCE = (pathlib.Path(word).resolve() for word in sys.argv[1:3])
HERE = SOURCE / "tests/hosts"
RATE, FRAMES = 15, 15
# Of the diagonal; float32 alone moves a vertex by a tenth of it.
EXACT, MORPHED = 1e-6, 1e-4


class Exports(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.kept = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls.kept.cleanup)
        cls.folder = pathlib.Path(cls.kept.name)
        (cls.folder / "obj").mkdir()
        (cls.folder / "ply").mkdir()
        for to in ("npy.npy", "a.glb", "pc2.pc2", "mdd.mdd", "obj/x.obj", "ply/x.ply", "a.usda"):
            subprocess.run([BUILD / "bin/eigencast-sender", "export", "heart", "--to", cls.folder / to, "--rate", str(RATE), "--level", "0.05",
                            "--duration", str(FRAMES / RATE), "--no-progress"], check=True, stderr=subprocess.DEVNULL)
        cls.exact = numpy.load(cls.folder / "npy.npy")
        cls.diagonal = numpy.linalg.norm(numpy.ptp(cls.exact[0], axis=0))
        cls.faces = [[int(corner) - 1 for corner in line.split()[1:]]
                     for line in (cls.folder / "npy.obj").read_text().splitlines() if line.startswith("f ")]

    def check(self, found, within, exact=None):
        exact = self.exact if exact is None else exact
        self.assertEqual(found.shape, exact.shape)
        off = numpy.linalg.norm(found - exact, axis=-1).max() / self.diagonal
        self.assertLessEqual(off, within)
        self.assertGreater(numpy.abs(exact - exact[:1]).max(), 0.01 * self.diagonal, "it moves")

    def in_node(self, file):
        out = self.folder / "node.f32"
        done = subprocess.run(["node", HERE / "exports_read.mjs", SOURCE / "build/tools/node/node_modules", SOURCE / "web/examples/node_modules",
                               file, str(RATE), str(FRAMES), out], capture_output=True, text=True, check=False)
        if done.returncode == 77:
            self.skipTest(done.stdout)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        return numpy.fromfile(out, numpy.float32).reshape(-1, 3)

    def test_the_poses_are_those_that_were_asked_for(self):
        self.assertEqual(len(self.exact), FRAMES)

    def test_gltf_is_valid_and_plays_in_three(self):
        found = self.in_node(self.folder / "a.glb").reshape(FRAMES, -1, 3)
        self.check(found, 1.1 * MORPHED)

    def test_usd_is_read_by_three(self):
        corners = numpy.array(self.faces).ravel()
        found = self.in_node(self.folder / "a.usda")
        self.check(found[len(corners):].reshape(FRAMES, -1, 3), EXACT)
        shown = self.exact[:1][:, corners]
        self.assertLessEqual(numpy.abs(found[:len(corners)] - shown[0]).max(), EXACT * self.diagonal)

    def test_sequences_are_read_by_three(self):
        files = {ending: sorted((self.folder / ending).iterdir()) for ending in ("obj", "ply")}
        self.assertEqual([len(all_of) for all_of in files.values()], [FRAMES, FRAMES])
        self.check(numpy.array([self.in_node(file) for file in files["ply"][::5]]), EXACT, self.exact[::5])
        corners = numpy.array(self.faces).ravel()
        self.check(numpy.array([self.in_node(file) for file in files["obj"][::5]]), EXACT, self.exact[::5][:, corners])

    def test_blender_shows_them(self):
        try:
            done = subprocess.run(["blender", "--background", "--factory-startup", "--python-exit-code", "1", "--python", HERE / "exports_blender.py", "--",
                                   self.folder, str(RATE), str(FRAMES)], capture_output=True, text=True, check=False)
        except FileNotFoundError:
            self.skipTest("no Blender: deploy/install-packages.sh full")
        self.assertEqual(done.returncode, 0, done.stdout[-3000:] + done.stderr[-3000:])
        x, y, z = (self.exact[..., d] for d in range(3))
        # glTF has y up, Blender z.
        self.check(numpy.load(self.folder / "glb.blender.npy"), 1.1 * MORPHED, numpy.stack([x, -z, y], axis=-1))
        for name in ("pc2", "mdd", "obj"):
            with self.subTest(name):
                self.check(numpy.load(self.folder / f"{name}.blender.npy"), EXACT)

    def test_vtk_reads_the_meshes(self):
        try:
            from vtkmodules.util.numpy_support import vtk_to_numpy
            from vtkmodules.vtkIOGeometry import vtkOBJReader
            from vtkmodules.vtkIOPLY import vtkPLYReader
        except ModuleNotFoundError as missing:
            self.skipTest(f"{missing}: deploy/install-packages.sh full")
        for ending, maker in (("obj", vtkOBJReader), ("ply", vtkPLYReader)):
            poses = []
            for file in sorted((self.folder / ending).iterdir()):
                reader = maker()
                reader.SetFileName(str(file))
                reader.Update()
                poses.append(vtk_to_numpy(reader.GetOutput().GetPoints().GetData()))
                self.assertEqual(reader.GetOutput().GetNumberOfPolys(), len(self.faces))
            with self.subTest(ending):
                self.check(numpy.array(poses), EXACT)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1] + sys.argv[3:], verbosity=2)
