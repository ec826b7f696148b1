# SPDX-License-Identifier: MIT
"""Objects that move, each another way that Blender has, made by code; and what of them a viewer should see. Runs inside Blender."""
import math

import bpy


def sphere(segments=24, rings=16):
    bpy.ops.mesh.primitive_uv_sphere_add(segments=segments, ring_count=rings)
    return bpy.context.object


def grid(side, size=2):
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=side, y_subdivisions=side, size=size)
    return bpy.context.object


def keyed(target, path, values):
    """{frame: value}, keyframes of `path`."""
    for frame, value in values.items():
        setattr(target, path, value)
        target.keyframe_insert(path, frame=frame)


def shape_key(side=20, end=120):
    made = grid(side)
    made.shape_key_add(name="Basis")
    key = made.shape_key_add(name="bump")
    for point in key.data:
        point.co.z += math.cos(point.co.x * 2) * math.cos(point.co.y * 2)
    keyed(key, "value", {1: 0.0, end: 1.0})
    made.location, made.rotation_euler, made.scale = (1, 2, 3), (0.3, 0.2, 0.1), (1, 2, 1)
    return made


def soft_body():
    made = sphere()
    made.location.z = 2
    made.modifiers.new("soft", "SOFT_BODY").settings.use_goal = False
    return made


def cloth():
    made = grid(24)
    pinned = made.vertex_groups.new(name="pinned")
    pinned.add([v.index for v in made.data.vertices if v.co.y > 0.99], 1, "ADD")
    made.modifiers.new("cloth", "CLOTH").settings.vertex_group_mass = "pinned"
    return made


def armature():
    bpy.ops.mesh.primitive_cylinder_add(vertices=24, depth=4, end_fill_type="TRIFAN")
    made = bpy.context.object
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.subdivide(number_cuts=3)
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.ops.object.armature_add(location=(0, 0, -2))
    rig = bpy.context.object
    bpy.ops.object.mode_set(mode="EDIT")
    lower = rig.data.edit_bones[0]
    lower.tail = (0, 0, 2)
    upper = rig.data.edit_bones.new("upper")
    upper.head, upper.tail, upper.parent = (0, 0, 2), (0, 0, 4), lower
    bpy.ops.object.mode_set(mode="OBJECT")
    made.select_set(True)
    bpy.ops.object.parent_set(type="ARMATURE_AUTO")
    bone = rig.pose.bones["upper"]
    bone.rotation_mode = "XYZ"
    keyed(bone, "rotation_euler", {1: (0, 0, 0), 120: (3.0, 0, 0)})
    return made


def geometry_nodes():
    made = grid(20)
    tree = bpy.data.node_groups.new("lift", "GeometryNodeTree")
    tree.inputs.new("NodeSocketGeometry", "Geometry")
    tree.outputs.new("NodeSocketGeometry", "Geometry")
    source, sink, move, time, offset = (tree.nodes.new(kind) for kind in ("NodeGroupInput", "NodeGroupOutput", "GeometryNodeSetPosition",
                                                                         "GeometryNodeInputSceneTime", "ShaderNodeVectorMath"))
    position = tree.nodes.new("GeometryNodeInputPosition")
    offset.operation = "SCALE"
    tree.links.new(source.outputs[0], move.inputs["Geometry"])
    tree.links.new(position.outputs[0], offset.inputs[0])
    tree.links.new(time.outputs["Seconds"], offset.inputs["Scale"])
    tree.links.new(offset.outputs[0], move.inputs["Offset"])
    tree.links.new(move.outputs[0], sink.inputs[0])
    made.modifiers.new("nodes", "NODES").node_group = tree
    return made


def text():
    bpy.ops.object.text_add()
    made = bpy.context.object
    made.data.body = "Eigen"
    keyed(made.data, "extrude", {1: 0.1, 120: 2.0})
    return made


def remesh():
    """Other faces in each frame."""
    made = sphere()
    made.modifiers.new("remesh", "REMESH").voxel_size = 0.2
    keyed(made.modifiers[0], "voxel_size", {1: 0.2, 120: 0.1})
    return made


KINDS = {kind.__name__: kind for kind in (shape_key, soft_body, cloth, armature, geometry_nodes, text, remesh)}


def seen(made):
    """Where the points are now, in a stream's axes: one by one, as Blender says."""
    evaluated = made.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    world = [evaluated.matrix_world @ vertex.co for vertex in mesh.vertices]
    evaluated.to_mesh_clear()
    return [(x, z, -y) for x, y, z in world]
