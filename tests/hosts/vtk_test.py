#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Real VTK pipelines through a real broker, both ways. Usage: host.py's."""
import math
import warnings

import host
import numpy

import eigencast
import eigencast.vtk
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkVersion
from vtkmodules.vtkCommonDataModel import vtkCellArray
from vtkmodules.vtkFiltersCore import vtkElevationFilter, vtkMassProperties, vtkPolyDataNormals, vtkStripper, vtkTriangleFilter
from vtkmodules.vtkFiltersGeneral import vtkWarpScalar
from vtkmodules.vtkFiltersSources import vtkCylinderSource, vtkPlaneSource, vtkSphereSource


def warped(side):
    """A plane of quadrilaterals, side x side, whose far end goes up: (plane, filter)."""
    plane = vtkPlaneSource()
    plane.SetResolution(side - 1, side - 1)
    height = vtkElevationFilter()
    height.SetLowPoint(-0.5, 0, 0)
    height.SetHighPoint(0.5, 0, 0)
    height.SetInputConnection(plane.GetOutputPort())
    warp = vtkWarpScalar()
    warp.SetInputConnection(height.GetOutputPort())
    return plane, warp


def points_of(algorithm):
    return vtk_to_numpy(algorithm.GetOutput().GetPoints().GetData())


class Vtk(host.HostTest):
    def test_the_page_streams_a_filter_and_shows_a_stream(self):
        _, warp = warped(30)
        names = {"warp": warp}
        exec(self.code("VTK"), names)

        def send(i):
            warp.SetScaleFactor(0.3 * math.sin(i / 10))
            warp.Update()

        last = self.follow(self.origin + "/warp", 60, send, lambda i: host.z_up(points_of(warp)), 0.01)
        self.assertEqual(len(last.triangles), 2 * 29 * 29)
        self.assertEqual(names["stream"].stats.bakes, 1)
        exec(self.code("VTK", 1), names)
        source, mapper = names["source"], names["mapper"]
        while source.GetOutputDataObject(0).GetNumberOfPoints() < 900:
            warp.Modified()
            warp.Update()
            source.next(timeout=0.1)
            mapper.Update()
        shown = mapper.GetInput()
        self.assertEqual(shown.GetNumberOfPolys(), 2 * 29 * 29)
        order = vtk_to_numpy(shown.GetPointData().GetArray("source_vertex"))
        kept = vtk_to_numpy(shown.GetPoints().GetData())
        numpy.testing.assert_allclose(kept, host.z_up(points_of(warp))[order], atol=0.01)
        before = kept.copy()
        for i in range(20):  # later poses do not write over what somebody keeps
            send(i)
            source.next(timeout=0.2)
            source.Update()
        numpy.testing.assert_array_equal(kept, before)
        source.close()
        names["stream"].close()

    def test_scalars_velocities_and_both_ways_round(self):
        _, flat = warped(20)
        warp = vtkPolyDataNormals()
        warp.SetInputConnection(flat.GetOutputPort())
        warp.Update()
        scalars = {"height": (0, 1, "m")}
        with eigencast.Stream(self.origin + "/named", scalars=scalars) as stream:
            with self.assertRaisesRegex(ValueError, r"no point data height of 1 components; it has: .*Elevation \(1\)"):
                eigencast.vtk.send(stream, warp.GetOutput())
            source = eigencast.vtk.Source(self.origin + "/named?rate=raw")
            source.Update()
            self.assertEqual(source.GetOutputDataObject(0).GetNumberOfPoints(), 0)
            while source.GetOutputDataObject(0).GetNumberOfPoints() < 400:
                eigencast.vtk.send(stream, warp.GetOutput(), arrays={"height": "Elevation"}, velocities="Normals")
                source.next(timeout=0.1)
                source.Update()
            data = source.GetOutputDataObject(0).GetPointData()
            order = vtk_to_numpy(data.GetArray("source_vertex"))
            elevation = vtk_to_numpy(warp.GetOutput().GetPointData().GetArray("Elevation"))
            numpy.testing.assert_allclose(vtk_to_numpy(data.GetArray("height")), elevation[order], atol=0.02)
            numpy.testing.assert_allclose(vtk_to_numpy(data.GetArray("velocity")), vtk_to_numpy(warp.GetOutput().GetPointData().GetNormals())[order], atol=0.2)
            self.assertEqual(data.GetNormals().GetNumberOfTuples(), 400)
            source.close()

    def test_faces_that_are_made_anew_or_as_strips_are_the_same_surface(self):
        sphere = vtkSphereSource()
        sphere.SetThetaResolution(16)
        sphere.SetPhiResolution(16)
        with eigencast.Stream(self.origin + "/sphere", rank=60) as stream:
            observer = eigencast.vtk.observe(stream, sphere)
            for i in range(5):
                sphere.SetRadius(1 + 0.1 * i)
                sphere.Update()
            self.assertTrue(stream.wait_live())
            self.assertEqual((stream.stats.poses_taken, stream.stats.bakes), (5, 1))
            observer.close()
            sphere.SetRadius(2)
            sphere.Update()
            self.assertEqual(stream.stats.poses_taken, 5)
            strips = vtkStripper()
            strips.SetInputConnection(sphere.GetOutputPort())
            strips.Update()
            self.assertGreater(strips.GetOutput().GetNumberOfStrips(), 0)
            eigencast.vtk.send(stream, strips.GetOutput())
            pose = self.follow(self.origin + "/sphere", 1, lambda i: None, lambda i: points_of(strips), 0.05)
            a, b, c = (pose.positions[pose.triangles[:, k]].astype(float) for k in range(3))
            mass = vtkMassProperties()
            mass.SetInputConnection(sphere.GetOutputPort())
            mass.Update()
            volume = (a * numpy.cross(b, c)).sum() / 6  # of the same sign: no triangle of a strip is turned
            self.assertAlmostEqual(volume / mass.GetVolume(), 1, delta=0.02)

    def test_strips_and_polygons_together_have_all_their_triangles(self):
        cylinder = vtkCylinderSource()
        cylinder.SetResolution(24)
        triangles = vtkTriangleFilter()
        triangles.SetInputConnection(cylinder.GetOutputPort())
        strips = vtkStripper()
        strips.SetInputConnection(triangles.GetOutputPort())
        strips.Update()
        mixed = strips.GetOutput()
        one = vtkCellArray()
        one.InsertNextCell(3, [0, 1, 2])
        mixed.SetPolys(one)
        corners, starts = eigencast.vtk._polygons(mixed.GetPolys(), mixed.GetStrips())
        faces = eigencast.mesh.triangles(corners, starts)
        whole = vtkTriangleFilter()
        whole.SetInputData(mixed)
        whole.Update()
        wanted = vtk_to_numpy(whole.GetOutput().GetPolys().GetConnectivityArray()).reshape(-1, 3)

        def turned(rows):
            return sorted(tuple(numpy.roll(row, -row.argmin())) for row in rows)

        self.assertEqual(turned(faces), turned(wanted))

    def test_other_faces_are_another_surface(self):
        plane, warp = warped(20)
        url = self.origin + "/finer"
        with eigencast.Stream(url, rank=40, up="z") as stream:
            eigencast.vtk.observe(stream, warp)
            for side in (20, 30):
                plane.SetResolution(side - 1, side - 1)
                self.follow(url, 1, lambda i: warp.Update(), lambda i: host.z_up(points_of(warp)), 0.02)
            self.assertEqual(stream.stats.bakes, 2)

    def test_what_cannot_be_sent_is_told_and_the_pipeline_goes_on(self):
        plane, warp = warped(5)
        with eigencast.Stream(self.origin + "/refused", rank=20, on_topology="raise") as stream:
            observer = eigencast.vtk.observe(stream, warp)
            warp.Update()
            self.assertIsNone(observer.error)
            plane.SetResolution(7, 7)
            with self.assertWarnsRegex(UserWarning, "topology"):
                warp.Update()
            self.assertIsInstance(observer.error, eigencast.Error)
            self.assertEqual(warp.GetOutput().GetNumberOfPoints(), 64)
            for wrong in (None, plane):
                with self.assertRaisesRegex(ValueError, "vtkPolyData"):
                    eigencast.vtk.send(stream, wrong)
            with self.assertRaisesRegex(ValueError, "no points"):
                eigencast.vtk.send(stream, vtkPlaneSource().GetOutput())

    def test_shared_streams_are_made_once(self):
        url = self.origin + "/shared"
        first = eigencast.vtk.shared(eigencast.Stream, url, rank=30)
        self.assertIs(eigencast.vtk.shared(eigencast.Stream, url, rank=30), first)
        other = eigencast.vtk.shared(eigencast.Stream, url, rank=40)
        self.assertIsNot(other, first)
        with self.assertRaisesRegex(ValueError, "closed"):
            first.send(numpy.zeros((3, 3)), [[0, 1, 2]])
        other.close()
        self.assertIsNot(eigencast.vtk.shared(eigencast.Stream, url, rank=40), other)


def make(origin, n):
    _, warp = warped(round(math.sqrt(n)))
    stream = eigencast.Stream(f"{origin}/{n}", up="z")

    def advance(i):
        warp.SetScaleFactor(0.3 * math.sin(i / 10))
        warp.Update()

    return stream, f"{origin}/{n}", round(math.sqrt(n)) ** 2, advance, lambda: eigencast.vtk.send(stream, warp.GetOutput())


if __name__ == "__main__":
    warnings.simplefilter("error", RuntimeWarning)
    host.main("VTK " + vtkVersion().GetVTKVersion(), make)
