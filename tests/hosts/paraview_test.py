#!/usr/bin/env pvpython
# SPDX-License-Identifier: MIT
"""ParaView's programmable filter and source with the scripts of docs/hosts.md, in its own Python. Usage: host.py's, under pvpython."""
import math

import host
import numpy

import eigencast
import eigencast.vtk
from paraview import simple, servermanager
from vtkmodules.util.numpy_support import vtk_to_numpy


def bent(side, script):
    """A plane, side x side, whose far end goes up, and the programmable filter after it."""
    plane = simple.Plane(XResolution=side - 1, YResolution=side - 1)
    height = simple.Elevation(Input=plane, LowPoint=[-0.5, 0, 0], HighPoint=[0.5, 0, 0])
    warp = simple.WarpByScalar(Input=height, Scalars=["POINTS", "Elevation"])
    return warp, simple.ProgrammableFilter(Input=warp, Script=script)


def points_of(proxy):
    return host.z_up(vtk_to_numpy(servermanager.Fetch(proxy).GetPoints().GetData()))


class ParaView(host.HostTest):
    def test_the_page_streams_what_passes_and_shows_a_stream(self):
        warp, sends = bent(30, self.code("ParaView"))

        def send(i):
            warp.ScaleFactor = 0.3 * math.sin(i / 10)
            sends.UpdatePipeline()

        last = self.follow(self.origin + "/part", 60, send, lambda i: points_of(sends), 0.01)
        self.assertEqual(len(last.triangles), 2 * 29 * 29)
        stream = eigencast.vtk.shared(eigencast.Stream, self.origin + "/part", up="z")
        self.assertEqual(stream.stats.bakes, 1)

        shows = simple.ProgrammableSource(OutputDataSetType="vtkPolyData", Script=self.code("ParaView", 1),
                                          ScriptRequestInformation=self.code("ParaView", 2))
        smooth = simple.Smooth(Input=shows)
        off = 1.0
        for step in range(1, 600):  # as ParaView's Play in real time does, until the last pose is there
            warp.ScaleFactor = 0.2
            sends.UpdatePipeline()
            shows.UpdatePipeline(0.1 * step)
            shown = servermanager.Fetch(shows)
            if shown.GetNumberOfPoints() == 900:
                order = vtk_to_numpy(shown.GetPointData().GetArray("source_vertex"))
                off = numpy.abs(vtk_to_numpy(shown.GetPoints().GetData()) - points_of(sends)[order]).max()
                if off < 0.01:
                    break
        self.assertLess(off, 0.01)
        smooth.UpdatePipeline()
        self.assertEqual(servermanager.Fetch(smooth).GetNumberOfPolys(), 2 * 29 * 29)
        stream.close()


def make(origin, n):
    side = round(math.sqrt(n))
    warp, _ = bent(side, "")
    stream = eigencast.Stream(f"{origin}/{n}", up="z")

    def advance(i):
        warp.ScaleFactor = 0.3 * math.sin(i / 10)
        warp.UpdatePipeline()

    return stream, f"{origin}/{n}", side ** 2, advance, lambda: eigencast.vtk.send(stream, warp.GetClientSideObject().GetOutputDataObject(0))


if __name__ == "__main__":
    host.main(str(simple.GetParaViewVersion()), make)
