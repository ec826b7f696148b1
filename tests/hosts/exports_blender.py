# SPDX-License-Identifier: MIT
"""In Blender: what files of FOLDER show at each of FRAMES poses, as NAME.blender.npy of (T, n, 3).

blender --background --factory-startup --python exports_blender.py -- FOLDER RATE FRAMES
"""
import pathlib
import sys

import bpy
import numpy

numpy.bool = bool  # Debian's importer of glTF is older than its numpy.
folder, rate, frames = pathlib.Path(sys.argv[-3]), int(sys.argv[-2]), int(sys.argv[-1])


def shown(thing):
    """Of the evaluated mesh, world coordinates."""
    graph = bpy.context.evaluated_depsgraph_get()
    mesh = thing.evaluated_get(graph).to_mesh()
    points = numpy.empty(3 * len(mesh.vertices), numpy.float32)
    mesh.vertices.foreach_get("co", points)
    world = numpy.array(thing.matrix_world)
    return points.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3]


def keep(name, thing):
    poses = []
    for frame in range(frames):
        bpy.context.scene.frame_set(frame)
        poses.append(shown(thing))
    numpy.save(folder / f"{name}.blender.npy", numpy.array(poses))


def the_mesh():
    return next(thing for thing in bpy.context.scene.objects if thing.type == "MESH")


def clear():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = rate


def import_obj(path):
    bpy.ops.wm.obj_import(filepath=str(path), forward_axis="Y", up_axis="Z")


clear()
bpy.ops.import_scene.gltf(filepath=str(folder / "a.glb"), merge_vertices=False)
keep("glb", the_mesh())
for ending in ("pc2", "mdd"):
    clear()
    import_obj(folder / f"{ending}.obj")
    cache = the_mesh().modifiers.new("cache", "MESH_CACHE")
    cache.cache_format, cache.filepath, cache.interpolation = ending.upper(), str(folder / f"{ending}.{ending}"), "NONE"
    cache.frame_start = 0
    keep(ending, the_mesh())
poses = []
for path in sorted((folder / "obj").iterdir()):
    clear()
    import_obj(path)
    poses.append(shown(the_mesh()))
numpy.save(folder / "obj.blender.npy", numpy.array(poses))
