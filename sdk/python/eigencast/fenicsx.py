# SPDX-License-Identifier: MIT
"""FEniCSx: the surface of a mesh that deforms, with fields on it, through a Stream. Needs python3-dolfinx.

    boundary = eigencast.fenicsx.Boundary(V)              # of the space of the displacement
    boundary.send(stream, u, {"mises": mises})            # after each step
"""
import numpy

from . import mesh

# Kinds of cells: where VTK's corners are among FEniCSx', and what mesh.boundary() calls them; None: they are the surface.
_CELLS = {"triangle": ((0, 1, 2), None), "quadrilateral": ((0, 1, 3, 2), None), "tetrahedron": ((0, 1, 2, 3), "tetra"),
          "hexahedron": ((0, 1, 3, 2, 4, 5, 7, 6), "hexahedron"), "prism": ((0, 1, 2, 3, 4, 5), "wedge"), "pyramid": ((0, 1, 3, 2, 4), "pyramid")}


class Boundary:
    """The surface of the mesh of a Lagrange space, by its nodes at corners of cells; of cells of two dimensions all.

      vertices  (m,): which nodes of the space (blocks of u.x.array) its points are
      points    (m, 3): where they are at rest
      faces     (F, 3) or (F, 4)
    Raises ValueError.
    """

    def __init__(self, V):
        domain = V.mesh
        if domain.comm.size > 1:
            raise ValueError(f"the mesh is spread over {domain.comm.size} processes: gather it on one, which streams it")
        order, kind = _CELLS.get(domain.topology.cell_name(), ((), None))
        if not order:
            raise ValueError(f"cells are {domain.topology.cell_name()}; a surface is made of {', '.join(_CELLS)}")
        self._space, self._order, self._places = V, list(order), {}
        nodes = numpy.asarray(V.tabulate_dof_coordinates())
        self._cells = self._corners_of(V)
        at_rest = numpy.asarray(domain.geometry.x)[_rows(domain.geometry.dofmap, domain)[:, self._order]]
        if self._cells.shape[1] != len(order) or not numpy.allclose(nodes[self._cells], at_rest):
            raise ValueError("the space has no nodes at the corners of cells: it must be a Lagrange space of degree 1 or more")
        if kind is None:
            self.vertices, faces = numpy.unique(self._cells, return_inverse=True)
            self.faces = faces.reshape(self._cells.shape)
        else:
            self.vertices, self.faces = mesh.boundary(nodes, self._cells, kind)
        self.points = nodes[self.vertices]
        number = numpy.full(len(nodes), -1)
        number[self.vertices] = numpy.arange(len(self.vertices))
        self._used = numpy.flatnonzero(number[self._cells.ravel()] >= 0)  # corners of cells that are on the surface
        self._point = number[self._cells.ravel()[self._used]]
        self._uses = numpy.bincount(self._point, minlength=len(self.vertices))

    def _corners_of(self, W):
        """Nodes of a space at the corners of cells (c, k); of one node a cell that one."""
        rows = _rows(W.dofmap.list, W.mesh)
        return numpy.repeat(rows, len(self._order), axis=1) if rows.shape[1] == 1 else rows[:, self._order]

    def _values(self, name, function):
        """At the points: of what jumps between cells the mean."""
        W = function.function_space
        if W.mesh is not self._space.mesh and W.mesh != self._space.mesh:
            raise ValueError(f"{name} lives on another mesh")
        if W.dofmap.index_map_bs != 1:
            raise ValueError(f"{name} has {W.dofmap.index_map_bs} components: a scalar has one")
        if id(W) not in self._places:
            places, first = self._corners_of(W).ravel()[self._used], numpy.empty(len(self.vertices), dtype=numpy.int64)
            first[self._point] = places
            self._places[id(W)] = W, first if (first[self._point] == places).all() else places
        values = numpy.real(function.x.array)[self._places[id(W)][1]]
        if len(values) == len(self.vertices):  # each point has one node
            return values
        return numpy.bincount(self._point, weights=values, minlength=len(self.vertices)) / self._uses

    def _moved(self, u, factor):
        """(m, 3) of a function of the space."""
        size = u.function_space.dofmap.index_map_bs
        if u.function_space != self._space or size not in (2, 3):
            raise ValueError("the displacement must be a function of two or three components in the space that the boundary was made for")
        rows = numpy.zeros((len(self.vertices), 3))
        rows[:, :size] = factor * numpy.real(u.x.array).reshape(-1, size)[self.vertices]
        return rows

    def send(self, stream, u=None, scalars=None, *, exaggerate=1.0, velocity=None, time_s=None):
        """Sends the surface, moved by the displacement u times `exaggerate`, through a Stream, with {name: function} as scalars and a
        velocity like u. Of functions that jump between cells (DG) the mean goes out. Returns and raises what Stream.send() does."""
        points = self.points if u is None else self.points + self._moved(u, exaggerate)
        return stream.send(points, self.faces, topology=self, time_s=time_s,
                           velocities=None if velocity is None else self._moved(velocity, exaggerate),
                           scalars={name: self._values(name, function) for name, function in (scalars or {}).items()} or None)


def _rows(numbers, domain):
    """A table of nodes, a row for each cell, of any version of dolfinx."""
    cells = domain.topology.index_map(domain.topology.dim)
    return numpy.asarray(getattr(numbers, "array", numbers)).reshape(cells.size_local + cells.num_ghosts, -1)
