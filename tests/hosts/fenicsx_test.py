#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Elasticity that FEniCSx solves, streamed from its boundary as docs/hosts.md has it. Usage: host.py's."""
import logging
import math

import host  # its folder for what is cached is FEniCSx', too
import dolfinx
import numpy
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py.PETSc import ScalarType

import eigencast
import eigencast.fenicsx


class Beam:
    """A steel beam, clamped at x = 0, under a load on all of it; linear elasticity."""

    def __init__(self, cell, counts, degree=1):
        self.domain = mesh.create_box(MPI.COMM_WORLD, [[0, 0, 0], [1.0, 0.2, 0.2]], counts, cell)
        self.V = fem.VectorFunctionSpace(self.domain, ("CG", degree))
        self.load = fem.Constant(self.domain, ScalarType((0, 0, 0)))
        lame, shear = 1.2e11, 8e10

        def stress(v):
            strain = ufl.sym(ufl.grad(v))
            return lame * ufl.tr(strain) * ufl.Identity(3) + 2 * shear * strain

        clamped = mesh.locate_entities_boundary(self.domain, 2, lambda x: numpy.isclose(x[0], 0))
        fixed = fem.dirichletbc(numpy.zeros(3, dtype=ScalarType), fem.locate_dofs_topological(self.V, 2, clamped), self.V)
        a, b = ufl.TrialFunction(self.V), ufl.TestFunction(self.V)
        self.problem = fem.petsc.LinearProblem(ufl.inner(stress(a), ufl.grad(b)) * ufl.dx, ufl.dot(self.load, b) * ufl.dx, bcs=[fixed],
                                               petsc_options={"ksp_type": "preonly", "pc_type": "lu"})
        self.u = self.problem.solve()
        part = stress(self.u) - ufl.tr(stress(self.u)) / 3 * ufl.Identity(3)
        cells = fem.FunctionSpace(self.domain, ("DG", 0))
        self.mises, self._mises = fem.Function(cells), fem.Expression(ufl.sqrt(1.5 * ufl.inner(part, part)), cells.element.interpolation_points())

    def solve(self, force):
        self.load.value[:] = 0, 0, -force
        self.u.x.array[:] = self.problem.solve().x.array
        self.mises.interpolate(self._mises)


class FEniCSx(host.HostTest):
    def test_the_page_streams_each_step_of_a_solver(self):
        beam = Beam(mesh.CellType.tetrahedron, [16, 4, 4])
        names = {"V": beam.V}
        exec(self.code("FEniCSx"), names)
        stream, boundary = names["stream"], names["boundary"]
        nodes = beam.V.tabulate_dof_coordinates()

        def send(i):
            beam.solve(4e8 * math.sin(i / 4))
            exec(self.code("FEniCSx", 1), {**names, "u": beam.u, "mises": beam.mises})

        def expected(i):
            return host.z_up((nodes + beam.u.x.array.reshape(-1, 3))[boundary.vertices])

        last = self.follow(self.origin + "/beam", 25, send, expected, 0.005)
        self.assertEqual(len(last.triangles), 2 * 2 * (16 * 4 + 16 * 4 + 4 * 4))
        self.assertEqual([(s.name, s.unit) for s in last.scalar_info], [("mises", "Pa")])
        self.assertGreater(numpy.abs(beam.u.x.array).max(), 0.01)
        # Stress is highest where the beam is clamped.
        rest = boundary.points[last.source_vertex]
        clamped, free = (last.scalars[where, 0].mean() for where in (rest[:, 0] < 0.1, rest[:, 0] > 0.9))
        self.assertGreater(clamped, 5 * free)
        a, b, c = (last.positions[last.triangles[:, k]].astype(float) for k in range(3))
        self.assertAlmostEqual((a * numpy.cross(b, c)).sum() / 6, 0.04, delta=0.001)  # outward
        stream.close()

    def test_values_are_those_of_the_corners_whatever_the_space(self):
        for cell, degree, faces in ((mesh.CellType.tetrahedron, 2, 2), (mesh.CellType.hexahedron, 1, 2), (mesh.CellType.hexahedron, 2, 2),
                                    (mesh.CellType.prism, 1, 2)):
            with self.subTest(cell=cell, degree=degree):
                domain = mesh.create_box(MPI.COMM_WORLD, [[0, 0, 0], [2, 1, 1]], [4, 3, 2], cell)
                V = fem.VectorFunctionSpace(domain, ("CG", degree))
                boundary = eigencast.fenicsx.Boundary(V)
                self.assertEqual(len(boundary.faces), 2 * faces * (4 * 3 + 4 * 2 + 3 * 2))
                a, b, c = (boundary.points[boundary.faces[:, k]] for k in range(3))
                self.assertAlmostEqual((a * numpy.cross(b, c)).sum() / 6, 2)
                u = fem.Function(V)
                u.interpolate(lambda x: numpy.stack([x[1], -x[0], x[2] ** 2]))
                x = boundary.points
                numpy.testing.assert_allclose(boundary._moved(u, 2.0), 2 * numpy.stack([x[:, 1], -x[:, 0], x[:, 2] ** 2], axis=1), atol=1e-12)
                for family, order in (("CG", 1), *((("CG", 2), ("DG", 1)) if cell != mesh.CellType.prism else ())):  # FFCx knows no others of prisms
                    w = fem.Function(fem.FunctionSpace(domain, (family, order)))
                    w.interpolate(lambda x: x[0] + 10 * x[1])
                    numpy.testing.assert_allclose(boundary._values("w", w), x[:, 0] + 10 * x[:, 1], atol=1e-9)
                constant = fem.Function(fem.FunctionSpace(domain, ("DG", 0)))
                constant.interpolate(lambda x: 3 + 0 * x[0])
                numpy.testing.assert_allclose(boundary._values("constant", constant), 3)

    def test_a_membrane_is_its_own_surface(self):
        domain = mesh.create_rectangle(MPI.COMM_WORLD, [[0, 0], [1, 1]], [8, 8], mesh.CellType.quadrilateral)
        boundary = eigencast.fenicsx.Boundary(fem.VectorFunctionSpace(domain, ("CG", 1), dim=3))
        self.assertEqual(boundary.faces.shape, (64, 4))
        corners = boundary.points[boundary.faces]
        sides = numpy.linalg.norm(corners - numpy.roll(corners, 1, axis=1), axis=2)
        numpy.testing.assert_allclose(sides, 1 / 8)  # around, not across

    def test_what_cannot_be_meant_is_refused(self):
        domain = mesh.create_unit_cube(MPI.COMM_WORLD, 2, 2, 2)
        vectors = fem.VectorFunctionSpace(domain, ("CG", 1))
        boundary, stream = eigencast.fenicsx.Boundary(vectors), eigencast.Stream(self.origin + "/refused", scalars={"stress": None})
        with self.assertRaisesRegex(ValueError, "Lagrange"):
            eigencast.fenicsx.Boundary(fem.VectorFunctionSpace(domain, ("DG", 0)))
        with self.assertRaisesRegex(ValueError, "interval"):
            eigencast.fenicsx.Boundary(fem.FunctionSpace(mesh.create_unit_interval(MPI.COMM_WORLD, 4), ("CG", 1)))
        with self.assertRaisesRegex(ValueError, "displacement"):
            boundary.send(stream, fem.Function(fem.FunctionSpace(domain, ("CG", 1))))
        with self.assertRaisesRegex(ValueError, "stress has 3 components"):
            boundary.send(stream, None, {"stress": fem.Function(vectors)})
        with self.assertRaisesRegex(ValueError, "another mesh"):
            boundary.send(stream, None, {"stress": fem.Function(fem.FunctionSpace(mesh.create_unit_cube(MPI.COMM_WORLD, 2, 2, 2), ("CG", 1)))})


def make(origin, n):
    side = round(math.sqrt(n / 2))
    domain = mesh.create_box(MPI.COMM_WORLD, [[0, 0, 0], [1, 1, 0.02]], [side, side, 2])
    boundary = eigencast.fenicsx.Boundary(fem.VectorFunctionSpace(domain, ("CG", 1)))
    u, w = fem.Function(boundary._space), fem.Function(fem.FunctionSpace(domain, ("DG", 0)))
    nodes = boundary._space.tabulate_dof_coordinates()
    stream = eigencast.Stream(f"{origin}/{n}", scalars={"w": (0, 1, "Pa")})

    def advance(i):
        u.x.array.reshape(-1, 3)[:, 1] = 0.1 * math.sin(i / 10) * nodes[:, 0] ** 2
        w.x.array[:] = 0.5 + 0.5 * math.sin(i / 10)

    return stream, f"{origin}/{n}", len(boundary.vertices), advance, lambda: boundary.send(stream, u, {"w": w})


if __name__ == "__main__":
    logging.disable(logging.WARNING)  # of each form that is compiled
    host.main("FEniCSx " + dolfinx.__version__, make)
