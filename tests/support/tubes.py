# SPDX-License-Identifier: MIT
"""A tube, ring by ring, as senders take it, and what programs write while they run."""
import array
import json


def mesh_of(pose, sides):
    """As OBJ. pose: float32 bytes, x, y and z of each vertex, so many a ring."""
    rest = array.array("f", pose)
    rings = len(rest) // 3 // sides
    corner = lambda i, j: i * sides + j % sides + 1
    quads = [(corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)) for i in range(rings - 1) for j in range(sides)]
    return "".join([*(f"v {rest[i]} {rest[i + 1]} {rest[i + 2]}\n" for i in range(0, len(rest), 3)), *(f"f {a} {b} {c}\nf {a} {c} {d}\n" for a, b, c, d in quads)])


def lines(path):
    """The whole ones of a file of JSON lines."""
    return [json.loads(line) for line in path.read_text().splitlines(keepends=True) if line.endswith("\n")] if path.exists() else []
