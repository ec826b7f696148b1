#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Makes what tests of real motion use where EIGENCAST_DATA_DIR is unset: a walking animal as a clip, a rigged file and points,
and meshes with faults. The same bytes everywhere; standard library only.

    make_data.py FOLDER
"""
import array
import itertools
import json
import math
import pathlib
import struct
import sys

FRAMES = 32
LEG_Y, HIP_Y, KNEE_Y = 0.98, 1.05, 0.5  # Legs are apart below LEG_Y.
LEGS = {"front_left": (0.75, 0.2, 0.0), "front_right": (0.75, -0.2, 0.5), "hind_left": (-0.75, 0.2, 0.75),
        "hind_right": (-0.75, -0.2, 0.25)}  # x, z, share of the step that it is ahead
BOXES = [(-1.0, 1.0, 1.0, 1.65, -0.35, 0.35), (0.8, 1.3, 1.4, 2.1, -0.15, 0.15), (0.9, 1.75, 1.9, 2.25, -0.15, 0.15),
         (-1.6, -0.9, 1.35, 1.55, -0.1, 0.1)]  # body, neck, head, tail: x, y, z from and to
BOXES += [(x - 0.13, x + 0.13, 0.0, 1.1, z - 0.13, z + 0.13) for x, z, _ in LEGS.values()]


def surface_of_cells(cells, size):
    """The skin of a set of cubes: vertices and triangles, turned outwards."""
    numbers, faces = {}, []

    def vertex(corner):
        return numbers.setdefault(corner, len(numbers))

    for cell in sorted(cells):
        for axis, side in itertools.product(range(3), (0, 1)):
            beside = list(cell)
            beside[axis] += 2 * side - 1
            if tuple(beside) in cells:
                continue
            u, v = (axis + 1) % 3, (axis + 2) % 3
            corners = []
            for du, dv in ((0, 0), (1, 0), (1, 1), (0, 1)):
                corner = list(cell)
                corner[axis] += side
                corner[u] += du
                corner[v] += dv
                corners.append(vertex(tuple(corner)))
            a, b, c, d = corners if side else corners[::-1]
            faces += [(a, b, c), (a, c, d)]
    return [[size * c for c in corner] for corner in numbers], faces


def smoothed(positions, faces, rounds):
    """Taubin's lambda|mu smoothing (A signal processing approach to fair surface design, 1995)."""
    around = [set() for _ in positions]
    for a, b, c in faces:
        around[a] |= {b, c}
        around[b] |= {a, c}
        around[c] |= {a, b}
    for share in (0.5, -0.53) * rounds:
        positions = [[p[k] + share * (sum(positions[j][k] for j in sorted(near)) / len(near) - p[k]) for k in range(3)]
                     for p, near in zip(positions, around)]
    return positions


def animal(size):
    inside = lambda p, b: all(b[2 * k] <= p[k] <= b[2 * k + 1] for k in range(3))
    around = range(-math.ceil(2 / size), math.ceil(2.5 / size))
    cells = {cell for cell in itertools.product(around, repeat=3)
             if any(inside([(c + 0.5) * size for c in cell], box) for box in BOXES)}
    positions, faces = surface_of_cells(cells, size)
    return smoothed(positions, faces, 6), faces


def ring(size):
    """Genus 1."""
    cells = {(x, y, z) for x, y, z in itertools.product(range(8), range(8), range(3)) if not (3 <= x <= 4 and 3 <= y <= 4)}
    positions, faces = surface_of_cells(cells, size)
    return smoothed(positions, faces, 6), faces


# ---- The gait: joints that turn about z, and linear blend skinning ----

JOINTS = [("body", None, (0, HIP_Y, 0)), ("neck", 0, (0.85, 1.6, 0)), ("tail", 0, (-1.0, 1.45, 0))]
for leg, (leg_x, leg_z, _) in LEGS.items():
    JOINTS += [(f"{leg}_hip", 0, (leg_x, HIP_Y, leg_z)), (f"{leg}_knee", len(JOINTS), (leg_x, KNEE_Y, leg_z))]


def angles(phase, stride):
    """Of every joint at this share of a step."""
    turn = lambda ahead: 2 * math.pi * (phase + ahead)
    result = [0.03 * stride * math.sin(2 * turn(0)), 0.12 * stride * math.sin(2 * turn(0.1)), 0.25 * stride * math.sin(turn(0))]
    for _, _, ahead in LEGS.values():
        result += [0.42 * stride * math.sin(turn(ahead)), -0.3 * stride * (1 + math.cos(turn(ahead)))]
    return result


def step(value):
    value = min(max(value, 0.0), 1.0)
    return value * value * (3 - 2 * value)


def weights_of(p):
    """Joint -> weight."""
    x, y, z = p
    if y < LEG_Y:
        n = next(i for i, (lx, lz, _) in enumerate(LEGS.values()) if x * lx > 0 and z * lz >= 0 and (z or lz > 0))
        hip, knee = step((LEG_Y - y) / 0.3), step((KNEE_Y + 0.12 - y) / 0.24)
        return {0: 1 - hip, 3 + 2 * n: hip * (1 - knee), 4 + 2 * n: hip * knee}
    neck, tail = step((x - 0.75) / 0.3) * step((y - 1.3) / 0.3), step((-0.85 - x) / 0.3)
    return {0: 1 - neck - tail, 1: neck, 2: tail}


def posed(positions, weights, phase, stride):
    world = []  # cos, sin, origin
    for (_, parent, rest), angle in zip(JOINTS, angles(phase, stride)):
        if parent is None:
            world.append((math.cos(angle), math.sin(angle), (rest[0], rest[1] + 0.02 * stride * math.sin(4 * math.pi * phase), rest[2])))
            continue
        c, s, origin = world[parent]
        dx, dy = rest[0] - JOINTS[parent][2][0], rest[1] - JOINTS[parent][2][1]
        turned = math.atan2(s, c) + angle
        world.append((math.cos(turned), math.sin(turned), (origin[0] + c * dx - s * dy, origin[1] + s * dx + c * dy, rest[2])))
    result = []
    for p, shares in zip(positions, weights):
        x = y = 0.0
        for joint, share in shares.items():
            c, s, origin = world[joint]
            dx, dy = p[0] - JOINTS[joint][2][0], p[1] - JOINTS[joint][2][1]
            x += share * (origin[0] + c * dx - s * dy)
            y += share * (origin[1] + s * dx + c * dy)
        result.append((x, y, p[2]))
    return result


# ---- Files ----

def write_npy(path, kind, shape, values):
    text = f"{{'descr': '<{kind}4', 'fortran_order': False, 'shape': {shape}, }}"
    text += " " * (63 - (len(text) + 10) % 64) + "\n"
    path.write_bytes(b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode() + array.array(kind, values).tobytes())


def write_obj(path, positions, faces):
    path.write_text("".join(f"v {x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in positions) +
                    "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in faces))


class Gltf:
    """A file of one mesh."""

    def __init__(self):
        self.data, self.views, self.accessors = b"", [], []

    def add(self, code, kind, rows, **more):
        flat = [value for row in rows for value in row]
        raw = struct.pack(f"<{len(flat)}{code}", *flat)
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(raw)})
        self.data += raw + b"\0" * (-len(raw) % 4)
        component = {"f": 5126, "H": 5123, "I": 5125}[code]
        self.accessors.append({"bufferView": len(self.views) - 1, "componentType": component, "count": len(rows), "type": kind, **more})
        return len(self.accessors) - 1

    def add_positions(self, rows):
        rows = [struct.unpack("<3f", struct.pack("<3f", *row)) for row in rows]
        return self.add("f", "VEC3", rows, min=[min(c) for c in zip(*rows)], max=[max(c) for c in zip(*rows)])

    def animation(self, name, node_of_path, times):
        """node_of_path: [(node, path, rows)]"""
        begin = self.add("f", "SCALAR", [(t,) for t in times], min=[times[0]], max=[times[-1]])
        kinds = {"rotation": "VEC4", "translation": "VEC3", "weights": "SCALAR"}
        samplers = [{"input": begin, "output": self.add("f", kinds[path], rows)} for _, path, rows in node_of_path]
        channels = [{"sampler": i, "target": {"node": node, "path": path}} for i, (node, path, _) in enumerate(node_of_path)]
        return {"name": name, "samplers": samplers, "channels": channels}

    def write(self, path, **document):
        """One file, or where it is to be text, a second one beside it."""
        buffer = {"byteLength": len(self.data)}
        if path.suffix == ".gltf":
            buffer["uri"] = path.with_suffix(".bin").name
        document = {"asset": {"version": "2.0"}, "scene": 0, "buffers": [buffer], "bufferViews": self.views, "accessors": self.accessors,
                    **document}
        text = json.dumps(document, separators=(",", ":")).encode()
        if path.suffix == ".gltf":
            path.write_bytes(text)
            path.with_suffix(".bin").write_bytes(self.data)
            return
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(self.data), 0x004E4942) + self.data
        path.write_bytes(struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks)


def write_rigged(path, positions, faces, weights):
    file = Gltf()
    top = [(sorted(shares.items(), key=lambda item: -item[1]) + [(0, 0.0)] * 4)[:4] for shares in weights]
    attributes = {"POSITION": file.add_positions(positions),
                  "JOINTS_0": file.add("H", "VEC4", [[joint for joint, _ in row] for row in top]),
                  "WEIGHTS_0": file.add("f", "VEC4", [[share for _, share in row] for row in top])}
    primitive = {"attributes": attributes, "indices": file.add("I", "SCALAR", [(v,) for face in faces for v in face])}
    inverse = [(1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, -x, -y, -z, 1) for _, _, (x, y, z) in JOINTS]
    skin = {"joints": list(range(1, len(JOINTS) + 1)), "inverseBindMatrices": file.add("f", "MAT4", inverse)}
    nodes = [{"mesh": 0, "skin": 0}]
    for number, (name, parent, rest) in enumerate(JOINTS):
        away = rest if parent is None else [a - b for a, b in zip(rest, JOINTS[parent][2])]
        nodes.append({"name": name, "translation": list(away)})
        if parent is not None:
            nodes[parent + 1].setdefault("children", []).append(number + 1)
    animations = []
    for name, stride, seconds in (("Walk", 0.7, 1.2), ("Run", 1.0, 0.6)):
        shares = [i / FRAMES for i in range(FRAMES + 1)]
        turns = [(joint + 1, "rotation", [(0, 0, math.sin(a / 2), math.cos(a / 2)) for a in (angles(share, stride)[joint] for share in shares)])
                 for joint in range(len(JOINTS))]
        animations.append(file.animation(name, turns, [seconds * share for share in shares]))
    file.write(path, scenes=[{"nodes": [0, 1]}], nodes=nodes, meshes=[{"primitives": [primitive]}], skins=[skin], animations=animations)


def write_morphing(path, positions, faces):
    """Two targets: it grows fat, it grows tall."""
    file = Gltf()
    fat, tall = [(0, 0, 0.6 * z) for _, _, z in positions], [(0, 0.3 * y, 0) for _, y, _ in positions]
    primitive = {"attributes": {"POSITION": file.add_positions(positions)}, "indices": file.add("I", "SCALAR", [(v,) for f in faces for v in f]),
                 "targets": [{"POSITION": file.add_positions(fat)}, {"POSITION": file.add_positions(tall)}]}
    weights = [(0,), (0,), (1,), (0,), (1,), (1,), (0,), (0,)]
    animation = file.animation("", [(0, "weights", weights)], [0, 0.5, 1, 1.5])
    file.write(path, scenes=[{"nodes": [0]}], nodes=[{"mesh": 0}], meshes=[{"primitives": [primitive], "weights": [0, 0]}], animations=[animation])


def write_meshes(folder, positions, faces):
    for name in ("clean", "nasty", "malformed"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    write_obj(folder / "clean/animal.obj", positions, faces)
    write_obj(folder / "clean/ring.obj", *ring(0.1))
    n = len(positions)
    write_obj(folder / "nasty/holes.obj", positions, [f for i, f in enumerate(faces) if i % 97 > 3])
    write_obj(folder / "nasty/turned.obj", positions, [f[::-1] if i % 5 == 0 else f for i, f in enumerate(faces)])
    # The front half has vertices of its own along the seam.
    front = {v: n + i for i, v in enumerate(sorted({v for f in faces if positions[f[0]][0] > 0 for v in f}))}
    write_obj(folder / "nasty/seam.obj", [*positions, *(positions[v] for v in front)],
              [tuple(front[v] for v in f) if positions[f[0]][0] > 0 else f for f in faces])
    herd = [(x + 4 * k, y, z) for k in range(3) for x, y, z in positions]
    write_obj(folder / "nasty/herd.obj", herd, [tuple(v + k * n for v in f) for k in range(3) for f in faces])
    # A fin on an edge, a face twice, one without an area, a vertex that nothing uses.
    a, b, c = faces[0]
    write_obj(folder / "nasty/odd.obj", [*positions, (0, 3, 0), (5, 5, 5), (0, 3, 1), (0, 3, 2), (0, 3, 3)],
              [*faces, (a, b, n), (a, b, c), (n + 2, n + 3, n + 4)])
    (folder / "malformed/empty.obj").write_text("")
    (folder / "malformed/cut.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n")
    (folder / "malformed/beyond.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n")


def main():
    folder = pathlib.Path(sys.argv[1])
    clip = folder / "animations/animal-walk"
    for made in (clip, folder / "gltf", folder / "clouds"):
        made.mkdir(parents=True, exist_ok=True)
    positions, faces = animal(0.085)
    weights = [weights_of(p) for p in positions]
    frames = [posed(positions, weights, i / FRAMES, 1.0) for i in range(FRAMES)]
    write_npy(clip / "vertices.npy", "f", (FRAMES, len(positions), 3), [c for frame in frames for p in frame for c in p])
    write_npy(clip / "faces.npy", "i", (len(faces), 3), [v for face in faces for v in face])
    write_obj(clip / "rest.obj", frames[0], faces)
    (folder / "clouds/animal.xyz").write_text("".join(f"{x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in positions))
    few, few_faces = animal(0.13)
    write_rigged(folder / "gltf/animal.glb", few, few_faces, [weights_of(p) for p in few])
    write_morphing(folder / "gltf/morphing.gltf", few, few_faces)
    write_meshes(folder / "meshes", few, few_faces)


if __name__ == "__main__":
    main()
