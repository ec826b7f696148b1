# SPDX-License-Identifier: MIT
"""Eigencast for Blender 3.6 and later: streams the evaluated mesh of the active object while it moves.

Install: Edit > Preferences > Add-ons > Install, choose this file. Then: 3D view, sidebar (N), tab Eigencast.
It runs `eigencast-sender pipe`, which must be installed; every modifier, rig and simulation counts, because what is streamed is the
mesh as Blender evaluates it. Alembic and USD caches play through it too.
"""
import pathlib
import shutil
import struct
import subprocess
import tempfile
import threading
import time

import bpy
import numpy

bl_info = {
    "name": "Eigencast sender",
    "author": "The Eigencast authors",
    "version": (0, 1, 0),
    "blender": (3, 6, 0),
    "location": "View3D > Sidebar > Eigencast",
    "description": "Streams the evaluated mesh of the active object to many viewers",
    "category": "Import-Export",
}


def y_up(positions):
    """Blender's z is up and its y goes into the picture; the stream's y is up and its z comes out of it."""
    return numpy.stack([positions[:, 0], positions[:, 2], -positions[:, 1]], axis=1).astype("<f4")


def evaluated_mesh(scene_object, depsgraph, with_faces):
    """World positions (n, 3) float32, y up, and triangles (F, 3), or None for the latter where they are not asked for."""
    evaluated = scene_object.evaluated_get(depsgraph)
    mesh = evaluated.to_mesh()
    try:
        flat = numpy.empty(3 * len(mesh.vertices), dtype=numpy.float32)
        mesh.vertices.foreach_get("co", flat)
        world = numpy.array(evaluated.matrix_world, dtype=numpy.float64)
        positions = y_up(flat.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3])
        if not with_faces:
            return positions, None
        mesh.calc_loop_triangles()
        corners = numpy.empty(3 * len(mesh.loop_triangles), dtype=numpy.int32)
        mesh.loop_triangles.foreach_get("vertices", corners)
        return positions, corners.reshape(-1, 3)
    finally:
        evaluated.to_mesh_clear()


def write_obj(path, positions, faces):
    with open(path, "w", encoding="ascii") as out:
        for x, y, z in positions.tolist():
            out.write(f"v {x!r} {y!r} {z!r}\n")
        for a, b, c in (faces + 1).tolist():
            out.write(f"f {a} {b} {c}\n")


class Stream:
    """One run of `eigencast-sender pipe`. send() never waits: a pose that has not been taken yet is replaced by the next."""

    def __init__(self, program, url, positions, faces, name):
        self.vertices = len(positions)
        self._folder = tempfile.TemporaryDirectory(prefix="eigencast-blender-")
        mesh = str(pathlib.Path(self._folder.name) / "rest.obj")
        write_obj(mesh, positions, faces)
        command = [program, "--no-progress", "pipe", "--mesh", mesh, "--name", name]
        if url:
            command += ["--to", url]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE)
        self._process.stdin.write(b"ECPOSES1" + struct.pack("<II", 1, self.vertices))
        self._ready = threading.Condition()
        self._pose = None
        self._ended = False
        self._start = time.monotonic()
        self.replaced = 0
        self._writer = threading.Thread(target=self._write, daemon=True)
        self._writer.start()

    def send(self, positions):
        with self._ready:
            if self._pose is not None:
                self.replaced += 1
            self._pose = struct.pack("<d", time.monotonic() - self._start) + positions.tobytes()
            self._ready.notify()

    def is_running(self):
        return self._process.poll() is None

    def stop(self):
        """Sends what is waiting, ends the sender, cleans up; at most a few seconds."""
        with self._ready:
            self._ended = True
            self._ready.notify()
        self._writer.join(timeout=2)
        self._process.terminate()
        try:
            self._process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        try:
            self._process.stdin.close()
        except OSError:
            pass
        self._folder.cleanup()
        return self._process.returncode

    def _write(self):
        while True:
            with self._ready:
                while self._pose is None and not self._ended:
                    self._ready.wait()
                pose, self._pose = self._pose, None
                if pose is None:
                    return
            try:
                self._process.stdin.write(pose)
                self._process.stdin.flush()
            except (BrokenPipeError, ValueError):
                return


class Session:
    """What is being streamed: one object of one scene, or nothing."""

    def __init__(self):
        self.stream = None
        self.object_name = ""

    def start(self, program, url, scene_object, depsgraph):
        found = shutil.which(program)
        if not found:
            raise RuntimeError(f"{program} is not installed, or not on the PATH")
        self.stop()
        positions, faces = evaluated_mesh(scene_object, depsgraph, with_faces=True)
        self.program, self.url, self.object_name = found, url, scene_object.name
        self.stream = Stream(found, url, positions, faces, scene_object.name)
        self.stream.send(positions)

    def update(self, scene, depsgraph):
        scene_object = scene.objects.get(self.object_name) if self.stream else None
        if scene_object is None:
            return
        positions, _ = evaluated_mesh(scene_object, depsgraph, with_faces=False)
        if len(positions) != self.stream.vertices:
            # Another topology is another surface; viewers go over to it by themselves.
            self.start(self.program, self.url, scene_object, depsgraph)
        else:
            self.stream.send(positions)

    def stop(self):
        stream, self.stream = self.stream, None
        return stream.stop() if stream else None


session = Session()


def on_change(scene, depsgraph=None):
    if session.stream:
        session.update(scene, depsgraph or bpy.context.evaluated_depsgraph_get())


class EIGENCAST_OT_start(bpy.types.Operator):
    bl_idname = "eigencast.start"
    bl_label = "Stream active object"
    bl_description = "Streams the evaluated mesh of the active object while it moves"

    @classmethod
    def poll(cls, context):
        return context.active_object is not None and context.active_object.type in {"MESH", "CURVE", "SURFACE", "META", "FONT"}

    def execute(self, context):
        settings = context.scene.eigencast
        try:
            session.start(settings.program, settings.url, context.active_object, context.evaluated_depsgraph_get())
        except (RuntimeError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class EIGENCAST_OT_stop(bpy.types.Operator):
    bl_idname = "eigencast.stop"
    bl_label = "Stop"
    bl_description = "Ends the stream"

    @classmethod
    def poll(cls, context):
        return session.stream is not None

    def execute(self, context):
        session.stop()
        return {"FINISHED"}


class EIGENCAST_PT_panel(bpy.types.Panel):
    bl_idname = "EIGENCAST_PT_panel"
    bl_label = "Eigencast"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Eigencast"

    def draw(self, context):
        settings = context.scene.eigencast
        self.layout.prop(settings, "url")
        self.layout.prop(settings, "program")
        if session.stream is None:
            self.layout.operator("eigencast.start")
            return
        running = session.stream.is_running()
        self.layout.label(text=f"{session.object_name}: {'streaming' if running else 'the sender has ended; see the console'}")
        self.layout.operator("eigencast.stop")


class EigencastSettings(bpy.types.PropertyGroup):
    url: bpy.props.StringProperty(name="To", default="http://localhost:7490/blender",
                                  description="http://host[:port]/stream; empty: the sender's current context")
    program: bpy.props.StringProperty(name="Program", default="eigencast-sender", description="Name or path of eigencast-sender")


CLASSES = (EigencastSettings, EIGENCAST_OT_start, EIGENCAST_OT_stop, EIGENCAST_PT_panel)


def handler_lists():
    return (bpy.app.handlers.frame_change_post, bpy.app.handlers.depsgraph_update_post)


def register():
    for each in CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Scene.eigencast = bpy.props.PointerProperty(type=EigencastSettings)
    for handlers in handler_lists():
        handlers.append(on_change)


def unregister():
    session.stop()
    for handlers in handler_lists():
        if on_change in handlers:
            handlers.remove(on_change)
    del bpy.types.Scene.eigencast
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)
