# SPDX-License-Identifier: MIT
"""VTK and ParaView: polydata goes into a Stream, and a stream is a source of polydata. Needs python3-vtk9, or ParaView's own Python.

    eigencast.vtk.observe(eigencast.Stream("http://broker:7490/part", up="z"), warp)  # whenever that filter has run
    mapper.SetInputConnection(eigencast.vtk.Source("http://broker:7490/part").GetOutputPort())
"""
import warnings

import numpy
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.util.vtkAlgorithm import VTKPythonAlgorithmBase
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData

from ._library import Error
from ._objects import Subscriber
from ._stream import Stream


def shared(kind, url, **options):
    """The Stream or Source (`kind`) of that URL and these options, made at the first call: for scripts that a host runs anew for each pose."""
    made_with, made = _shared.get((kind, url), (None, None))
    if made is None or made_with != options or made.closed:
        if made is not None:
            made.close()
        made = kind(url, **options)
        _shared[kind, url] = options, made
    return made


_shared = {}


def send(stream, polydata, *, arrays=None, velocities=None, time_s=None):
    """Sends the points, polygons and strips of a vtkPolyData through a Stream, with the point data that the stream announces as scalars.

      arrays      {name of a scalar: name of its array} where they differ
      velocities  name of the array that holds them
    Points are read in place. Faces are read when VTK says that they were modified, and compared by content: lines and vertices are left out.
    Returns and raises what Stream.send() does.
    """
    if not isinstance(polydata, vtkPolyData):
        given = type(polydata).__name__ if polydata is None else polydata.GetClassName()
        raise ValueError(f"a vtkPolyData is wanted, not {given}; vtkGeometryFilter gives the surface of a data set")
    if polydata.GetNumberOfPoints() == 0:
        raise ValueError("the polydata has no points yet: update the filter first")
    parts = (polydata.GetPolys(), polydata.GetStrips())
    state = tuple(each.GetMTime() for part in parts for each in (part, part.GetConnectivityArray(), part.GetOffsetsArray()))
    topology = (polydata.GetNumberOfPoints(), state)
    faces = offsets = None
    if topology != stream._topology:  # VTK's times of modification are unique in a process
        faces, offsets = _polygons(*parts)
    scalars = {name: _array(polydata, (arrays or {}).get(name, name), 1) for name in stream._scalars}
    return stream.send(vtk_to_numpy(polydata.GetPoints().GetData()), faces, offsets, scalars=scalars or None,
                       velocities=None if velocities is None else _array(polydata, velocities, 3), time_s=time_s, topology=topology)


def _array(polydata, name, width):
    found = polydata.GetPointData().GetArray(name)
    if found is None or found.GetNumberOfComponents() != width:
        data = polydata.GetPointData()
        there = ", ".join(f"{data.GetArrayName(i)} ({data.GetArray(i).GetNumberOfComponents()})" for i in range(data.GetNumberOfArrays()))
        raise ValueError(f"the polydata has no point data {name} of {width} components; it has: {there or 'none'}")
    return vtk_to_numpy(found)


def _polygons(polygons, strips):
    """Corners of all, and where each begins."""
    corners, starts = (vtk_to_numpy(each) for each in (polygons.GetConnectivityArray(), polygons.GetOffsetsArray()))
    if strips.GetNumberOfCells() == 0:
        return corners, starts
    strip, begin = (vtk_to_numpy(each) for each in (strips.GetConnectivityArray(), strips.GetOffsetsArray()))
    at = numpy.concatenate([numpy.arange(first, end - 2) for first, end in zip(begin[:-1], begin[1:])])
    odd = (at - begin[numpy.searchsorted(begin, at, side="right") - 1]) % 2
    triangles = numpy.stack([strip[at], strip[at + 1 + odd], strip[at + 2 - odd]], axis=1)
    return numpy.concatenate([corners, triangles.ravel()]), numpy.concatenate([starts, starts[-1] + 3 * numpy.arange(1, len(at) + 1)])


class observe:
    """Sends the output of a vtkAlgorithm each time it has run, until close(). Options as of send().

    What cannot be sent is a warning, once of a kind, and `error`; the pipeline goes on.
    """

    def __init__(self, stream, algorithm, port=0, **options):
        self.stream, self.error, self._algorithm, self._port, self._options = stream, None, algorithm, port, options
        self._tag = algorithm.AddObserver("EndEvent", self._has_run)

    def _has_run(self, *_):
        try:
            send(self.stream, self._algorithm.GetOutputDataObject(self._port), **self._options)
            self.error = None
        except (Error, ValueError) as error:
            self.error = error
            warnings.warn(f"not streamed: {error}", stacklevel=2)

    def close(self):
        """The stream stays open."""
        self._algorithm.RemoveObserver(self._tag)


class Source(VTKPythonAlgorithmBase):
    """The poses of http://host:port/stream as a vtkPolyData; options as of Subscriber. next() steps it; what it gives is VTK's own and may
    be kept.

    Point data: normals, scalars by their names, `velocity`, `colour`, and `source_vertex`: which point of the sender's each one is.
    """

    def __init__(self, url, **options):
        super().__init__(nInputPorts=0, nOutputPorts=1, outputType="vtkPolyData")
        self._pose, self._subscriber = vtkPolyData(), Subscriber(url, **options)

    def next(self, timeout=1.0):
        """Takes the next pose, oldest first; False: none came within `timeout` seconds. Raises Error."""
        pose = self._subscriber.next(timeout, copy=False)
        if pose is None:
            return False
        made, points = vtkPolyData(), vtkPoints()
        points.SetData(_owned(pose.positions))
        made.SetPoints(points)
        made.SetPolys(self._cells(pose.triangles.view(numpy.int32).reshape(-1)))
        data = made.GetPointData()
        named = {"source_vertex": pose.source_vertex.view(numpy.int32), "velocity": pose.velocities, "colour": pose.vertex_colours}
        for i in range(pose.scalars.shape[1]):
            named[pose.scalar_info[i].name if pose.scalar_info else f"scalar{i}"] = pose.scalars[:, i]
        for name, values in named.items():
            if values is not None:
                array = _owned(values)
                array.SetName(name)
                data.AddArray(array)
        if pose.normals is not None:
            data.SetNormals(_owned(pose.normals))
        self._pose = made
        self.Modified()
        return True

    def _cells(self, corners):
        """Those of the pose before where they are the same, so that what comes after need not look at them again."""
        before = self._pose.GetPolys()
        if numpy.array_equal(vtk_to_numpy(before.GetConnectivityArray()), corners):
            return before
        cells = vtkCellArray()
        cells.SetData(_owned(numpy.arange(0, corners.size + 1, 3, dtype=numpy.int32)), _owned(corners))
        return cells

    def fill(self, polydata):
        """Makes `polydata` the present pose; empty before the first."""
        polydata.ShallowCopy(self._pose)

    def RequestData(self, request, inputs, outputs):
        self.fill(vtkPolyData.GetData(outputs, 0))
        return 1

    def stats(self):
        return self._subscriber.stats()

    @property
    def closed(self):
        return self._subscriber.closed

    def close(self):
        self._subscriber.close()


def _owned(rows):
    """In memory of VTK's own: a later pose overwrites the library's, and VTK's shallow copies know nothing of numpy's."""
    return numpy_to_vtk(numpy.ascontiguousarray(rows), deep=True)
