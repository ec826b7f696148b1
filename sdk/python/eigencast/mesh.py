# SPDX-License-Identifier: MIT
"""Meshes as programs have them, as triangles over points: what Stream.send() and bake() take.

What picks some of the points gives their numbers, (m,), as well: stream points[vertices] of each pose.
"""
import ctypes

import numpy

from . import _library
from ._library import LIBRARY, check


def _numbers(values, dtype, what):
    """As the library takes them, which has no negative numbers."""
    given = numpy.asarray(values)
    if given.size and given.dtype.kind not in "iu":
        raise ValueError(f"{what} must be whole numbers from 0 on, not {given.dtype}")
    if given.size and given.dtype != dtype:
        # Negative ones are the largest as unsigned: one look finds both, and 32 bits need no copy.
        most, given = min(numpy.iinfo(given.dtype).max, numpy.iinfo(dtype).max), given.astype(given.dtype.newbyteorder("="), copy=False)
        given = given.view(f"u{given.itemsize}")
        if given.max() > most:
            raise ValueError(f"{what} must be whole numbers from 0 on")
    return numpy.ascontiguousarray(given, dtype=dtype)


def _points(points):
    rows = numpy.ascontiguousarray(points, dtype=numpy.float64)
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise ValueError(f"points must be (n, 3), not {rows.shape}")
    return rows


def _pointer(array, c_type):
    return array.ctypes.data_as(ctypes.POINTER(c_type))


def _taken(make, *arguments):
    handle = ctypes.c_void_p()
    check(make(*arguments, ctypes.byref(handle)))
    try:
        raw = _library.MeshArrays()
        check(LIBRARY.ec_mesh_get(handle, ctypes.byref(raw)))

        def copied(pointer, *shape):
            return numpy.ctypeslib.as_array(pointer, shape).copy() if shape[0] else numpy.empty(shape, dtype=numpy.uint32)

        return copied(raw.vertices, raw.vertex_count), copied(raw.faces, raw.face_count, 3)
    finally:
        LIBRARY.ec_mesh_release(handle)


def triangles(connectivity, offsets):
    """Polygons as triangles (F, 3): each one a fan from its first corner, always the same. Polygon i has the corners
    connectivity[offsets[i]:offsets[i + 1]]; those of fewer than three are left out. Raises Error, ValueError."""
    corners = _numbers(connectivity, numpy.uint32, "connectivity").reshape(-1)
    starts = _numbers(offsets, numpy.uint64, "offsets").reshape(-1)
    return _taken(LIBRARY.ec_mesh_triangles, _pointer(corners, ctypes.c_uint32), corners.size,
                  _pointer(starts, ctypes.c_uint64), starts.size)[1]


def boundary(points, cells, kind):
    """The surface of a solid: the sides that only one cell has, facing outward, as (vertices, triangles).

      cells  (c, 4), (c, 8), (c, 6) or (c, 5) numbers of points, in VTK's order
      kind   "tetra", "hexahedron", "wedge" or "pyramid": of all cells
    Raises Error, ValueError.
    """
    rows, corners = _points(points), _numbers(cells, numpy.uint32, "cells")
    return _taken(LIBRARY.ec_mesh_boundary, _pointer(rows, ctypes.c_double), len(rows), _pointer(corners, ctypes.c_uint32), corners.size,
                  str(kind).encode())


def weld(points, faces, tolerance=0.0):
    """Joins points within `tolerance` of one another (default: at the same place), as (vertices, triangles): of a triangle soup a surface.
    Faces that lose a corner are dropped. Raises Error, ValueError."""
    rows, corners = _points(points), _numbers(faces, numpy.uint32, "faces")
    if corners.size and corners.shape[-1] != 3:
        raise ValueError(f"faces must be (F, 3), not {corners.shape}")
    return _taken(LIBRARY.ec_mesh_weld, _pointer(rows, ctypes.c_double), len(rows), _pointer(corners, ctypes.c_uint32), corners.size // 3,
                  float(tolerance))
