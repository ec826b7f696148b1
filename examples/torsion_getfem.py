#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""A rubber bar that is twisted, as GetFEM solves it: torsion_getfem.py http://127.0.0.1:7490/bar."""
import sys
import time

import eigencast
import getfem
import numpy

POSES, FULL_TURN = 60, 2.0  # radians

domain = getfem.Mesh("cartesian", numpy.linspace(0, 1, 25), numpy.linspace(-0.1, 0.1, 7), numpy.linspace(-0.1, 0.1, 7))
sides = domain.outer_faces()
normals = domain.normal_of_faces(sides)
domain.set_region(1, sides[:, normals[0] < -0.9])
domain.set_region(2, sides[:, normals[0] > 0.9])

space = getfem.MeshFem(domain, 3)  # the displacement
space.set_classical_fem(1)
nodes = space.basic_dof_nodes()[:, ::3].T
dofs, first = space.basic_dof_from_cvid()
cells = numpy.array([dofs[a:b:3] // 3 for a, b in zip(first[:-1], first[1:])])
vertices, faces = eigencast.mesh.boundary(nodes, cells[:, [0, 1, 3, 2, 4, 5, 7, 6]], "hexahedron")

model = getfem.Model("real")
model.add_fem_variable("u", space)
model.add_initialized_data("params", [1.0, 1.0])  # Lame's
model.add_finite_strain_elasticity_brick(getfem.MeshIm(domain, getfem.Integ("IM_GAUSS_PARALLELEPIPED(3,2)")), "SaintVenant Kirchhoff", "u", "params")
model.add_initialized_fem_data("held", space, numpy.zeros(space.nbdof()))
model.add_initialized_fem_data("turned", space, numpy.zeros(space.nbdof()))
model.add_Dirichlet_condition_with_multipliers(getfem.MeshIm(domain, 3), "u", 1, 1, "held")
model.add_Dirichlet_condition_with_multipliers(getfem.MeshIm(domain, 3), "u", 1, 2, "turned")


def solved(angle):
    """Where the points of the surface are once the free end is turned by `angle`."""
    c, s = numpy.cos(angle), numpy.sin(angle)
    goal = nodes @ numpy.array([[1, 0, 0], [0, c, s], [0, -s, c]]) - nodes
    model.set_variable("turned", goal.ravel())
    model.solve("max_res", 1e-6, "max_iter", 50)
    return (nodes + model.variable("u").reshape(-1, 3))[vertices]


with eigencast.Stream(sys.argv[1]) as stream:
    stream.send(solved(0), faces)
    while not stream.stats.subscribers:  # so that a viewer sees it from its beginning
        time.sleep(0.05)
    for pose in range(1, POSES):
        points = solved(FULL_TURN * pose / POSES)
        time.sleep(1 / 30)
        stream.send(points)
print(f"sent {POSES} poses")
