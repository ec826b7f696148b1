#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""A beam that CalculiX bends, and the same in meshio's files, played as docs/hosts.md has it. Usage: host.py's."""
import os
import pathlib
import re
import subprocess
import sys
import tempfile

import host
import meshio
import numpy

import eigencast
from eigencast import results

NX, NY, NZ = 20, 4, 4
STEPS = 20


def beam_input():
    """Bricks with bending modes, clamped at one end, whose other end is pushed down and up."""
    def node(i, j, k):
        return 101 + i + (NX + 1) * (j + (NY + 1) * k)

    grid = [(i, j, k) for k in range(NZ + 1) for j in range(NY + 1) for i in range(NX + 1)]
    lines = ["*NODE, NSET=ALL", *(f"{node(i, j, k)}, {i / NX}, {0.2 * j / NY}, {0.2 * k / NZ}" for i, j, k in grid), "*ELEMENT, TYPE=C3D8I, ELSET=BEAM"]
    ring = ((0, 0), (1, 0), (1, 1), (0, 1))
    for number, (i, j, k) in enumerate(((i, j, k) for i, j, k in grid if i < NX and j < NY and k < NZ), 1):
        lines.append(", ".join(map(str, [number] + [node(i + a, j + b, k + c) for c in (0, 1) for a, b in ring])))
    for name, at in (("FIXED", 0), ("TIP", NX)):
        lines += [f"*NSET, NSET={name}", *(f"{node(i, j, k)}," for i, j, k in grid if i == at)]
    return "\n".join(lines) + """
*MATERIAL, NAME=STEEL
*ELASTIC
2.1e11, 0.3
*SOLID SECTION, ELSET=BEAM, MATERIAL=STEEL
*BOUNDARY
FIXED, 1, 3
*AMPLITUDE, NAME=WAVE
0, 0, 0.25, 1, 0.5, 0, 0.75, -1, 1, 0
*STEP, NLGEOM, INC=1000
*STATIC, DIRECT
0.05, 1
*CLOAD, AMPLITUDE=WAVE
TIP, 3, -5e5
*NODE FILE, FREQUENCY=1
U
*EL FILE
S
*END STEP
"""


class Results(host.HostTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.keeper = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls.keeper.cleanup)
        cls.folder = pathlib.Path(cls.keeper.name)
        (cls.folder / "beam.inp").write_text(beam_input())
        subprocess.run(["ccx", "beam"], cwd=cls.folder, check=True, stdout=subprocess.DEVNULL)
        cls.frd = results.Frd(cls.folder / "beam.frd")
        cls.steps = list(cls.frd.steps())

    def play(self, *words):
        return subprocess.run([sys.executable, "-m", "eigencast.results", *map(str, words)], cwd=self.folder, capture_output=True, text=True, timeout=300)

    def test_a_result_of_calculix_is_read_as_it_wrote_it(self):
        self.assertEqual((len(self.frd.points), len(self.steps)), (525, STEPS))
        self.assertEqual([(kind, corners.shape) for kind, corners in self.frd.cells], [("hexahedron", (320, 8))])
        bent = [fields["DISP"][:, 2].min() for _, fields in self.steps]
        self.assertEqual(int(numpy.argmin(bent)), 4)  # at the fifth step the load is highest
        # Euler and Bernoulli: F L^3 / 3 E I; the load is on each of 25 nodes.
        self.assertAlmostEqual(bent[4] / (-25 * 5e5 / (3 * 2.1e11 * 0.2 ** 4 / 12)), 1, delta=0.1)
        stress = self.steps[4][1]
        clamped = stress["mises"][self.frd.points[:, 0] == 0].max()
        self.assertGreater(clamped, 5 * stress["mises"][self.frd.points[:, 0] == 1].mean())
        faces, each = results.poses(self.frd, scalars=["mises", "DISP"])
        points, scalars = next(each)
        self.assertEqual(len(faces), 4 * (NX * NY + NX * NZ + NY * NZ))
        a, b, c = (points[faces[:, k]] for k in range(3))
        self.assertAlmostEqual((a * numpy.cross(b, c)).sum() / 6, 0.04, delta=1e-3)
        self.assertEqual({name: len(column) for name, column in scalars.items()}, {"mises": len(points), "DISP": len(points)})

    def test_every_step_arrives_in_order(self):
        faces, each = results.poses(self.frd, scalars=["mises"])
        steps, url = list(each), self.origin + "/steps"
        with eigencast.Stream(url, up="z", scalars={"mises": (0, 1e10, "Pa")}) as stream:
            self.follow(url, STEPS, lambda i: stream.send(steps[i][0], faces, scalars=steps[i][1]), lambda i: host.z_up(steps[i][0]), 0.01)

    def test_the_page_plays_it(self):
        page = (host.SOURCE / "docs/hosts.md").read_text(encoding="utf-8")
        words = re.search(r"^    python3 -m eigencast\.results (beam\.frd .*)$", page, re.M)[1]
        done = self.play(*words.replace("http://localhost:7490", self.origin).split())
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn(f"{STEPS} poses sent", done.stdout)
        self.assertRegex(done.stdout, "mises [0-9.e+-]+ to [0-9.e+-]+")

    def test_series_that_meshio_reads_are_the_same_steps(self):
        cells = [("hexahedron", self.frd.cells[0][1])]
        for i, (points, fields) in enumerate(self.steps):
            meshio.write(self.folder / f"step_{i}.vtu", meshio.Mesh(points, cells, point_data={"DISP": fields["DISP"], "mises": fields["mises"]}))
        entries = "".join(f'<DataSet timestep="{i}" file="step_{i}.vtu"/>' for i in reversed(range(STEPS)))
        (self.folder / "beam.pvd").write_text(f'<VTKFile type="Collection"><Collection>{entries}</Collection></VTKFile>')
        self.addCleanup(os.chdir, os.getcwd())
        os.chdir(self.folder)  # where meshio puts the .h5
        with meshio.xdmf.TimeSeriesWriter("beam.xdmf", data_format="HDF") as writer:
            writer.write_points_cells(self.frd.points, cells)
            for i, (_, fields) in enumerate(self.steps):
                writer.write_data(i, point_data={"DISP": fields["DISP"], "mises": fields["mises"]})
        wanted_faces, wanted = results.poses(self.frd, scalars=["mises"])
        wanted = list(wanted)
        for names in ([str(self.folder / "step_*.vtu")], [str(self.folder / "beam.pvd")], [str(self.folder / "beam.xdmf")]):
            with self.subTest(names=names):
                faces, each = results.poses(results.read(names), scalars=["mises"])
                numpy.testing.assert_array_equal(faces, wanted_faces)
                found = list(each)
                self.assertEqual(len(found), STEPS)
                for (points, scalars), (wanted_points, wanted_scalars) in zip(found, wanted):
                    numpy.testing.assert_allclose(points, wanted_points, atol=1e-12)
                    numpy.testing.assert_allclose(scalars["mises"], wanted_scalars["mises"])
        done = self.play("beam.pvd", "--to", self.origin + "/pvd", "--scalar", "DISP:m", "--rate", "60")
        self.assertEqual((done.returncode, f"{STEPS} poses sent" in done.stdout), (0, True), done.stderr)

    def test_what_cannot_be_played_is_named(self):
        whole = (self.folder / "beam.frd").read_bytes()
        lines = whole.splitlines(keepends=True)
        for name, text, said in (("none.frd", b"", "no nodes"), ("cut.frd", b"".join(lines[:40]), "does not end"),
                                 ("binary.frd", whole.replace(lines[11].rstrip(), lines[11].rstrip()[:-1] + b"2"), "binary"),
                                 ("letters.frd", whole.replace(lines[12], lines[12].replace(b"0.00000E+00", b"zero.0E+000")), "lines 13 to"),
                                 ("nan.frd", whole.replace(b" 0.00000E+00", b"         NaN", 1), "step 1: the positions are not all finite"),
                                 ("node.frd", whole.replace(b" -2       101", b" -2       999", 1), "node 999"),
                                 ("type.frd", re.sub(rb"( -1         1 {4})1", rb"\g<1>9", whole, count=1), "type 9|not 4 nodes")):
            with self.subTest(name=name):
                (self.folder / name).write_bytes(text)
                done = self.play(name, "--to", self.origin + "/bad")
                self.assertEqual(done.returncode, 1, done.stdout)
                self.assertRegex(done.stderr, said)
                self.assertNotIn("Traceback", done.stderr)
        for words, said in ((["beam.frd", "--scalar", "heat"], "no field heat; there are: DISP"), (["nothing.vtu"], "no such file"),
                            (["beam.frd", "--rate", "0"], "--rate")):
            done = self.play(*words, "--to", "not a url")
            self.assertEqual(done.returncode, 1, done.stdout)
            self.assertRegex(done.stderr, said)
        (self.folder / "away.pvd").write_text('<VTKFile><Collection><DataSet timestep="0" file="../../etc/passwd"/></Collection></VTKFile>')
        self.assertRegex(self.play("away.pvd", "--to", self.origin + "/bad").stderr, "below its own folder")

    def test_a_step_that_is_being_written_is_left_for_later(self):
        lines = (self.folder / "beam.frd").read_bytes().splitlines(keepends=True)
        last = max(i for i, line in enumerate(lines) if line.startswith(b"  100C"))
        (self.folder / "growing.frd").write_bytes(b"".join(lines[:last + 50]))
        self.assertEqual(len(list(results.Frd(self.folder / "growing.frd").steps())), STEPS)


if __name__ == "__main__":
    host.main("results", None)
