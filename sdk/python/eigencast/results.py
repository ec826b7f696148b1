# SPDX-License-Identifier: MIT
"""Plays what a finite-element program wrote: CalculiX (.frd), and with python3-meshio series of VTU and others, PVD and XDMF.

    python3 -m eigencast.results beam.frd --to http://broker:7490/beam --scalar mises:Pa
"""
import argparse
import glob
import pathlib
import re
import sys
import time
import xml.etree.ElementTree

import numpy

from . import mesh
from ._library import Error
from ._stream import Stream

# Cells by their corners, which come first: of a solid as mesh.boundary() calls it, of a surface None.
_KINDS = {"tetra": (4, "tetra"), "hexahedron": (8, "hexahedron"), "wedge": (6, "wedge"), "pyramid": (5, "pyramid"), "triangle": (3, None), "quad": (4, None)}
_FRD_KINDS = {1: ("hexahedron", 8), 2: ("wedge", 6), 3: ("tetra", 4), 4: ("hexahedron20", 20), 5: ("wedge15", 15), 6: ("tetra10", 10), 7: ("triangle", 3),
              8: ("triangle6", 6), 9: ("quad", 4), 10: ("quad8", 8), 11: ("line", 2), 12: ("line3", 3)}
_DISPLACEMENTS = ("DISP", "displacement", "Displacement", "u", "U")


class Frd:
    """A result that CalculiX wrote as text: nodes, elements, and the fields of each step. Raises ValueError, OSError."""

    def __init__(self, path):
        self._path = path
        self._lines = pathlib.Path(path).read_bytes().splitlines()
        self.points, self.cells, self._blocks = None, [], []
        at = 0
        while at < len(self._lines):
            line = self._lines[at]
            if line.startswith((b"    2C", b"    3C", b"  100C")):
                end = at + 1
                while end < len(self._lines) and self._lines[end][:3] != b" -3":
                    end += 1
                if end == len(self._lines):
                    if self.points is None or not line.startswith(b"  100C"):
                        raise ValueError(f"{path}: line {at + 1} begins a block that does not end")
                    break  # CalculiX is still writing this step
                if line.startswith(b"    2C"):
                    self._read_nodes(at, end)
                elif line.startswith(b"    3C"):
                    self._read_elements(at, end)
                else:
                    self._blocks.append((at, end))
                at = end
            at += 1
        if self.points is None or not self.cells:
            raise ValueError(f"{path}: no nodes or no elements: is it a result of CalculiX?")

    def _format(self, at, columns):
        """0: numbers of 5 digits, 1: of 10."""
        found = self._lines[at][columns].strip() or b"0"
        if found not in (b"0", b"1"):
            raise ValueError(f"{self._path}: line {at + 1}: the block is binary; write it as text (*NODE FILE, not OUTPUT=BINARY)")
        return int(found)

    def _numbers(self, begin, end, digits, count):
        """Of lines alike: node numbers, and `count` values of 12 columns."""
        lines, width = self._lines[begin:end], 3 + digits + 12 * count
        rows = [line[:width].ljust(width) for line in lines]
        if any(row[:3] != b" -1" for row in rows):
            raise ValueError(f"{self._path}: lines {begin + 1} to {end}: one that begins with -1 is wanted for each node")
        table = numpy.frombuffer(b"".join(rows), dtype=numpy.dtype([("", "S3"), ("node", f"S{digits}"), ("values", "S12", (count,))]))
        try:
            return table["node"].astype(numpy.int64), table["values"].astype(numpy.float64).reshape(-1, count)
        except ValueError as error:
            raise ValueError(f"{self._path}: lines {begin + 1} to {end}: {error}") from None

    def _read_nodes(self, at, end):
        nodes, points = self._numbers(at + 1, end, (5, 10)[self._format(at, slice(73, 75))], 3)
        order = numpy.argsort(nodes)
        self._nodes, self.points = nodes[order], points[order]

    def _read_elements(self, at, end):
        digits, found, corners = (5, 10)[self._format(at, slice(73, 75))], {}, None
        for number, line in enumerate(self._lines[at + 1:end], at + 2):
            if line[:3] == b" -1":
                kind = int(line[3 + digits:8 + digits])
                if kind not in _FRD_KINDS:
                    raise ValueError(f"{self._path}: line {number}: elements of type {kind} are not known")
                corners = []
                found.setdefault(kind, []).append(corners)
            elif line[:3] == b" -2" and corners is not None:
                corners += [int(line[i:i + digits]) for i in range(3, len(line.rstrip()), digits)]
        for kind, rows in found.items():
            name, count = _FRD_KINDS[kind]
            if any(len(row) != count for row in rows):
                raise ValueError(f"{self._path}: an element of type {kind} has not {count} nodes")
            self.cells.append((name, self._places(numpy.array(rows))))

    def _places(self, nodes):
        places = numpy.searchsorted(self._nodes, nodes).clip(0, len(self._nodes) - 1)
        if (self._nodes[places] != nodes).any():
            raise ValueError(f"{self._path}: node {nodes[self._nodes[places] != nodes].flat[0]} is named, but has no place")
        return places

    def steps(self):
        """(points, {name: (n,) or (n, k)}) of each step; of STRESS also mises."""
        last, fields = None, {}
        for at, end in self._blocks:
            step = self._lines[at][58:63], self._lines[at][12:24]
            if step != last and fields:
                yield self.points, fields
                fields = {}
            last = step
            name, values = self._field(at, end)
            if values is not None:
                fields[name] = values
                if name == "STRESS" and values.shape[1] == 6:
                    x, y, z, xy, yz, zx = values.T
                    fields["mises"] = numpy.sqrt(((x - y) ** 2 + (y - z) ** 2 + (z - x) ** 2) / 2 + 3 * (xy ** 2 + yz ** 2 + zx ** 2))
        if fields:
            yield self.points, fields

    def _field(self, at, end):
        digits, begin, name, stored = (5, 10)[self._format(at, slice(73, 75))], at + 1, "", 0
        while begin < end and self._lines[begin][:3] in (b" -4", b" -5"):
            line = self._lines[begin]
            if line[:3] == b" -4":
                name = line[5:13].decode("ascii", "replace").strip()
            elif line[33:38].strip() in (b"", b"0"):  # else it is computed from the others
                stored += 1
            begin += 1
        if not 1 <= stored <= 6 or begin == end:
            return name, None
        nodes, values = self._numbers(begin, end, digits, stored)
        rows = numpy.zeros((len(self.points), stored))
        rows[self._places(nodes)] = values
        return name, rows[:, 0] if stored == 1 else rows


class Meshes:
    """What meshio reads: one file for each step. Raises ValueError, OSError."""

    def __init__(self, paths):
        self._paths = paths
        first = self._read(paths[0])
        self.points, self.cells = first.points, [(block.type, block.data) for block in first.cells]

    @staticmethod
    def _read(path):
        import meshio

        if not pathlib.Path(path).is_file():
            raise ValueError(f"{path}: there is no such file")
        try:
            return meshio.read(path)
        except (meshio.ReadError, SystemExit, KeyError, AssertionError) as error:
            raise ValueError(f"{path}: meshio cannot read it: {error or type(error).__name__}") from None

    def steps(self):
        for path in self._paths:
            found = self._read(path)
            if len(found.points) != len(self.points):
                raise ValueError(f"{path}: {len(found.points)} points; the first file has {len(self.points)}")
            yield found.points, found.point_data


class Xdmf:
    """A series in one XDMF file, of one mesh. Raises ValueError, OSError."""

    def __init__(self, path):
        self._path = path
        with self._reader() as reader:
            self.points, self._blocks = reader.read_points_cells()
            self.cells = [(block.type, block.data) for block in self._blocks]

    def _reader(self):
        import meshio

        try:
            return meshio.xdmf.TimeSeriesReader(self._path)
        except (meshio.ReadError, xml.etree.ElementTree.ParseError) as error:
            raise ValueError(f"{self._path}: meshio finds no series of one mesh: {error or 'another form of XDMF'}") from None

    def steps(self):
        with self._reader() as reader:
            reader.cells = self._blocks  # read_data() wants read_points_cells() before
            for k in range(reader.num_steps):
                yield self.points, reader.read_data(k)[1]


def read(names):
    """The result in a file, or in a file for each step. Raises ValueError, OSError."""
    paths = sum((sorted(glob.glob(name), key=_natural) or [name] for name in names), [])
    first = pathlib.Path(paths[0])
    if len(paths) == 1 and first.suffix == ".frd":
        return Frd(first)
    if len(paths) == 1 and first.suffix in (".xdmf", ".xmf"):
        return Xdmf(first)
    if len(paths) == 1 and first.suffix == ".pvd":
        try:
            listed = xml.etree.ElementTree.parse(first).findall("Collection/DataSet")
        except xml.etree.ElementTree.ParseError as error:
            raise ValueError(f"{first}: {error}") from None
        folder = first.resolve().parent
        paths = [folder / entry.get("file", "") for entry in sorted(listed, key=lambda entry: float(entry.get("timestep", 0)))]
        if not paths or any(folder not in path.resolve().parents for path in paths):
            raise ValueError(f"{first}: it must name files below its own folder, at least one")
    return Meshes(paths)


def _natural(name):
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", name)]


def surface(points, cells):
    """(vertices, faces) of what cells bound, and of cells that are a surface. Raises ValueError, Error."""
    found = []
    for name, corners in cells:
        count, kind = next((_KINDS[k] for k in _KINDS if re.fullmatch(rf"{k}\d*", name)), (0, None))
        corners = numpy.asarray(corners)[:, :count]
        if kind:
            vertices, faces = mesh.boundary(points, corners, kind)
            found.append(vertices[faces])
        elif count:
            found.append(corners if count == 3 else mesh.triangles(corners.ravel(), numpy.arange(0, corners.size + 1, 4)))
    if not found:
        raise ValueError(f"no cells that bound a surface, but {', '.join(sorted({name for name, _ in cells})) or 'none'}")
    vertices, faces = numpy.unique(numpy.concatenate(found), return_inverse=True)
    return vertices, faces.reshape(-1, 3)


def _column(fields, name, where):
    """(m,): of a field of several components its length."""
    if name not in fields:
        raise ValueError(f"there is no field {name}; there are: {', '.join(fields) or 'none'}")
    values = numpy.asarray(fields[name])[where]
    return values if values.ndim == 1 else numpy.linalg.norm(values.reshape(len(where), -1), axis=1)


def poses(result, displacement=None, exaggerate=1.0, scalars=()):
    """(faces, iterator over (points (m, 3), {name: (m,)})). Raises ValueError."""
    vertices, faces = surface(_wide(result.points), result.cells)

    def each():
        for points, fields in result.steps():
            name = displacement if displacement is not None else next((known for known in _DISPLACEMENTS if known in fields), "")
            points = _wide(points)[vertices]
            if name:
                if name not in fields or numpy.ndim(fields[name]) != 2:
                    raise ValueError(f"there is no field {name} of two or three components; there are: {', '.join(fields) or 'none'}")
                points = points + exaggerate * _wide(fields[name])[vertices]
            yield points, {scalar: _column(fields, scalar, vertices) for scalar in scalars}

    return faces, each()


def _wide(rows):
    rows = numpy.asarray(rows, dtype=float)
    return rows if rows.shape[1] == 3 else numpy.pad(rows, ((0, 0), (0, 3 - rows.shape[1])))


def main(words=None):
    parser = argparse.ArgumentParser(prog="python3 -m eigencast.results", description="Streams a result of finite elements, step by step.")
    parser.add_argument("result", nargs="+", help=".frd, .xdmf, .pvd, or files of the steps (a quoted glob) that meshio reads")
    parser.add_argument("--to", required=True, help="http://host:port/stream")
    parser.add_argument("--displacement", help=f"field that moves the points; \"\": none (default: the first of {', '.join(_DISPLACEMENTS)})")
    parser.add_argument("--exaggerate", type=float, default=1.0, help="times the displacement")
    parser.add_argument("--scalar", action="append", default=[], metavar="NAME[:UNIT]", help="field to send along; of several components its length; mises")
    parser.add_argument("--rate", type=float, default=30.0, help="steps a second (default: 30)")
    parser.add_argument("--loop", action="store_true", help="again and again, until Ctrl-C")
    parser.add_argument("--up", choices=("y", "z"), default="z")
    given = parser.parse_args(words)
    try:
        if not given.rate > 0:
            raise ValueError("--rate must be above 0")
        units = dict((*scalar.split(":", 1), "")[:2] for scalar in given.scalar)
        result = read(given.result)

        def again():
            return poses(result, given.displacement, given.exaggerate, list(units))

        ranges, steps = {}, 0
        for points, values in again()[1]:  # all of it, so that a bad step is found before the first is sent, and for the ranges
            steps += 1
            for name, column in {"positions": points, **values}.items():
                if not numpy.isfinite(column).all():
                    raise ValueError(f"step {steps}: the {name} are not all finite")
            for name, column in values.items():
                low, high = ranges.get(name, (numpy.inf, -numpy.inf))
                ranges[name] = min(low, float(column.min())), max(high, float(column.max()))
        if steps == 0:
            raise ValueError("the result has no steps")
        print(f"{steps} steps of {len(again()[0])} triangles; " + ", ".join(f"{name} {low:g} to {high:g}" for name, (low, high) in ranges.items()), flush=True)
        scalars = {name: (low, high if high > low else low + 1, units[name]) for name, (low, high) in ranges.items()}
        with Stream(given.to, up=given.up, scalars=scalars, max_rate_hz=numpy.inf) as stream:
            sent = play(stream, again, given.rate, given.loop)
        print(f"{sent} poses sent")
    except KeyboardInterrupt:
        return 0
    except (Error, ValueError, OSError, ImportError) as error:
        print(f"eigencast.results: {error}", file=sys.stderr)
        return 1
    return 0


def play(stream, again, rate_hz, loop):
    """At an absolute schedule once the surface is baked and a broker there."""
    sent, start = 0, None
    while start is None or loop:
        faces, each = again()
        for points, values in each:
            if start is None:
                stream.send(points, faces, scalars=values or None, topology="result")
                while not stream.wait_live(1):
                    print(stream.stats.detail, flush=True)
                start = time.monotonic() - 1 / rate_hz  # the first is on its way
                sent = 1
                continue
            sent += 1
            time.sleep(max(0.0, start + sent / rate_hz - time.monotonic()))
            stream.send(points, faces, scalars=values or None, time_s=sent / rate_hz, topology="result")
    return sent


if __name__ == "__main__":
    sys.exit(main())
