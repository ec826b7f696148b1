# SPDX-License-Identifier: MIT
"""Eigencast for Blender 3.4 and later: streams objects as Blender evaluates them, while they move. See tools/blender/README.md.

By eigencast.Stream, in this process: it bakes, codes and sends in a thread of its own, so that Blender never waits.
"""
import re
import threading

import bpy
import numpy
from bpy.app.handlers import persistent

bl_info = {
    "name": "Eigencast",
    "author": "The Eigencast authors",
    "version": (0, 1, 0),
    "blender": (3, 4, 0),
    "location": "View3D > Sidebar > Eigencast",
    "description": "Streams objects to many viewers while they move",
    "category": "Import-Export",
}

SURFACES = {"MESH", "CURVE", "SURFACE", "META", "FONT"}
TICK_S = 0.5


def sdk():
    """eigencast, which comes in the zip. RuntimeError: libeigencast is missing, or another one."""
    try:
        from . import eigencast
    except (ImportError, AttributeError) as error:
        raise RuntimeError(f"eigencast cannot be loaded: {error}") from error
    return eigencast


class Faces:
    """The polygons of a mesh, and when they are others. Triangles are made once of each: cut anew at every pose, quads that bend would
    change sides."""

    def __init__(self):
        self.count = 0  #: How often they have been others.
        self._was = None

    def of(self, mesh):
        """Triangles (F, 3), or None as long as the polygons are the same by their content."""
        # Unsigned, as Blender has them: others it converts one by one, twelve times as slowly.
        corners, starts = numpy.empty(len(mesh.loops), numpy.uint32), numpy.empty(len(mesh.polygons), numpy.uint32)
        mesh.loops.foreach_get("vertex_index", corners)
        mesh.polygons.foreach_get("loop_start", starts)
        now = (len(mesh.vertices), corners, starts)
        if self._was and self._was[0] == now[0] and all(map(numpy.array_equal, self._was[1:], now[1:])):
            return None
        mesh.calc_loop_triangles()
        triangles = numpy.empty(3 * len(mesh.loop_triangles), numpy.uint32)
        mesh.loop_triangles.foreach_get("vertices", triangles)
        self._was, self.count = now, self.count + 1
        return triangles.reshape(-1, 3)


def world_points(mesh, matrix):
    points = numpy.empty(3 * len(mesh.vertices), numpy.float32)
    mesh.vertices.foreach_get("co", points)
    world = numpy.array(matrix, numpy.float32)
    return points.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3]


class Live:
    """The stream of one object: followed by reference, through undo (which ends references) by the names it had."""

    def __init__(self, target, url, **options):
        """Raises eigencast.Error, ValueError, RuntimeError."""
        self.url, self.names = url, [target.name]
        self.ended = ""  #: Why there are no more poses.
        self.skipped = ""  #: Why the last pose was not taken.
        self.skipped_poses = 0
        self._target, self._faces, self._triangles, self._points = target, Faces(), None, None
        self.stream = sdk().Stream(url, up="z", name=target.name, **options)
        self.stats = self.stream.stats

    @property
    def name(self):
        return self.names[-1]

    def target(self):
        """None: it is gone."""
        try:
            target = self._target if self._target.users_scene else None
        except ReferenceError:
            return None
        if target is not None and target.name != self.name:
            self.names.append(target.name)
        return target

    def find_again(self):
        """After undo and redo."""
        found = (bpy.data.objects.get(name) for name in reversed(self.names))
        self._target = next((each for each in found if each is not None), self._target)

    def update(self, depsgraph, changed=None):
        """Sends the object as `depsgraph` has it.  changed: ids that are others than before (default: all)"""
        if self.ended:
            return
        target = self.target()
        if target is None:
            self.end("the object was deleted")
            return
        if depsgraph.scene not in target.users_scene or (changed is not None and target not in changed):
            return
        evaluated = target.evaluated_get(depsgraph)
        if not evaluated.is_evaluated:
            self.skip("it is not in this view layer, or disabled in viewports")
        elif not target.visible_get(view_layer=depsgraph.view_layer):
            self.skip("it is hidden, so that Blender does not evaluate it")
        else:
            self._send(evaluated, is_edit=changed is not None)

    def _send(self, evaluated, is_edit):
        try:
            mesh = evaluated.to_mesh()
        except RuntimeError as error:
            self.skip(str(error))
            return
        try:
            if not mesh.polygons:
                self.skip("it has no faces")
                return
            triangles = self._faces.of(mesh)
            before, self._points = self._points, world_points(mesh, evaluated.matrix_world)
        finally:
            evaluated.to_mesh_clear()
        if is_edit and triangles is None and not self.skipped and numpy.array_equal(before, self._points):
            return  # Windows and undo tell of edits that change nothing.
        self._triangles = triangles if triangles is not None else self._triangles
        self._give()

    def _give(self):
        try:
            self.stream.send(self._points, self._triangles, topology=self._faces.count)
            self.skipped = ""
        except (sdk().Error, ValueError) as error:
            self.skip(str(error))

    def skip(self, why):
        self.skipped, self.skipped_poses = why, self.skipped_poses + 1

    def look(self):
        """What has become of it meanwhile."""
        if self.ended:
            return
        if self.target() is None:
            self.end("the object was deleted")
            return
        before, self.stats = self.stats, self.stream.stats
        if self.stats.reconnects != before.reconnects and self._points is not None and not self.skipped:
            self._give()  # Of one that stands still nothing else would come.

    def end(self, why):
        """Sends what waits, in a thread: that takes up to a second."""
        if self.ended:
            return
        self.ended, self.stats = why, self.stream.stats
        threading.Thread(target=self.stream.close).start()

    def state(self):
        """(icon, line) for people."""
        stats = self.stats
        if self.ended:
            return "X", f"ended: {self.ended}"
        if self.skipped:
            return "ERROR", f"skipped: {self.skipped}"
        if stats.live:
            return "CHECKMARK", f"live, {stats.subscribers} watching"
        return "TIME", stats.detail

    def figures(self):
        """Lines for people: what went out, and of what did not, why."""
        stats = self.stats
        lines = [f"{stats.poses_sent} poses sent, {stats.bytes_sent / 1e3:.0f} kB"] + ([f"{stats.bakes} surfaces"] if stats.bakes > 1 else [])
        for count, why in ((stats.poses_early, "above the limit: newer ones went"), (stats.poses_superseded, "before bake or connection"),
                           (stats.poses_dropped - stats.poses_unusable, "dropped: the link is behind"),
                           (stats.poses_unusable, f"dropped: {stats.detail}"), (self.skipped_poses, "skipped")):
            if count:
                lines.append(f"{count} {why}")
        return lines


lives = []
undoing = False


def evaluates_for_people(depsgraph):
    """A render has surfaces of its own, of other detail, from another thread; without a window they are all there is."""
    return depsgraph.mode == "VIEWPORT" or bpy.app.background


@persistent
def on_frame(scene, depsgraph=None):
    depsgraph = depsgraph or bpy.context.evaluated_depsgraph_get()
    if undoing or not evaluates_for_people(depsgraph):
        return
    for each in lives:
        each.update(depsgraph)


@persistent
def on_edit(scene, depsgraph=None):
    depsgraph = depsgraph or bpy.context.evaluated_depsgraph_get()
    if undoing or not lives or not evaluates_for_people(depsgraph):
        return
    changed = {update.id.original for update in depsgraph.updates if update.is_updated_geometry or update.is_updated_transform}
    for each in lives:
        each.update(depsgraph, changed)


@persistent
def on_load(*_):
    for each in lives:
        each.end("another file was opened")


@persistent
def before_undo(*_):
    global undoing
    undoing = True


@persistent
def after_undo(*_):
    global undoing
    undoing = False
    for each in lives:
        each.find_again()


def handlers():
    lists = bpy.app.handlers
    return ((lists.frame_change_post, on_frame), (lists.depsgraph_update_post, on_edit), (lists.load_pre, on_load),
            (lists.undo_pre, before_undo), (lists.redo_pre, before_undo), (lists.undo_post, after_undo), (lists.redo_post, after_undo))


def tick():
    global undoing
    undoing = False  # It is over, even if nobody said so.
    for each in lives:
        each.look()
    for window in bpy.context.window_manager.windows if lives else ():
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()
    return TICK_S


def url_for(pattern, target):
    """Streams are named by letters, digits, '.', '_' and '-'."""
    return pattern.replace("{object}", re.sub(r"[^A-Za-z0-9._-]+", "_", target.name).strip(".") or "object")


class EIGENCAST_OT_start(bpy.types.Operator):
    bl_idname = "eigencast.start"
    bl_label = "Stream selected"
    bl_description = "Streams the selected objects, as Blender evaluates them, while they move"

    @classmethod
    def poll(cls, context):
        return bool(context.selected_objects)

    def execute(self, context):
        settings = context.scene.eigencast
        preferences = context.preferences.addons.get(__package__)
        token = preferences.preferences.token_file if preferences else ""
        options = {"rank": settings.rank, "on_topology": settings.on_topology, "token": "@" + bpy.path.abspath(token) if token else None,
                   "max_rate_hz": settings.max_rate_hz or 1.25 * context.scene.render.fps / context.scene.render.fps_base}
        started = 0
        for target in context.selected_objects:
            if target.type not in SURFACES:
                self.report({"WARNING"}, f"{target.name} has no surface")
                continue
            url = url_for(settings.url, target)
            if any(each.url == url and not each.ended and each.target() != target for each in lives):
                self.report({"ERROR"}, f"{target.name}: another object goes to {url}; {{object}} in the URL stands for the name")
                continue
            for each in lives:
                if each.url == url:
                    each.end("it was started again")
            lives[:] = [each for each in lives if each.url != url]
            try:
                live = Live(target, url, **options)
            except (RuntimeError, ValueError) as error:  # eigencast.Error is one.
                self.report({"ERROR"}, f"{target.name}: {error}")
                continue
            lives.append(live)
            live.update(context.evaluated_depsgraph_get())
            started += 1
        return {"FINISHED"} if started else {"CANCELLED"}


class OneOfLives:
    number: bpy.props.IntProperty(options={"HIDDEN"})

    def execute(self, context):
        if not 0 <= self.number < len(lives):
            return {"CANCELLED"}
        self.do(context, lives[self.number])
        return {"FINISHED"}


class EIGENCAST_OT_stop(OneOfLives, bpy.types.Operator):
    bl_idname = "eigencast.stop"
    bl_label = "End"
    bl_description = "Ends this stream, or takes it off the list"

    def do(self, context, live):
        live.end("stopped")
        del lives[self.number]


class EIGENCAST_OT_page(OneOfLives, bpy.types.Operator):
    bl_idname = "eigencast.page"
    bl_label = "Page"
    bl_description = "Opens the stream's page in the browser"

    def do(self, context, live):
        bpy.ops.wm.url_open(url=re.sub(r"^ws", "http", live.url))


class EIGENCAST_PT_panel(bpy.types.Panel):
    bl_idname = "EIGENCAST_PT_panel"
    bl_label = "Eigencast"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Eigencast"

    def draw(self, context):
        settings, layout = context.scene.eigencast, self.layout
        for name in ("url", "rank", "max_rate_hz", "on_topology"):
            layout.prop(settings, name)
        try:
            sdk()
        except RuntimeError as error:
            for line in re.findall(r".{1,48}(?:\s|$)", str(error)):
                layout.label(text=line)
            return
        layout.operator("eigencast.start")
        for number, live in enumerate(lives):
            box = layout.box()
            row = box.row()
            row.label(text=live.name, icon="OUTLINER_OB_MESH")
            row.operator("eigencast.page", text="", icon="URL").number = number
            row.operator("eigencast.stop", text="", icon="X").number = number
            icon, state = live.state()
            box.label(text=state, icon=icon)
            for line in (live.url, *live.figures()):
                box.label(text=line)


class EigencastSettings(bpy.types.PropertyGroup):
    url: bpy.props.StringProperty(name="To", default="http://localhost:7490/{object}",
                                  description="http://host[:port]/stream; {object} stands for the object's name")
    rank: bpy.props.IntProperty(name="Coefficients", default=200, min=1, max=2000, description="Per axis: more are more faithful, and more bits")
    max_rate_hz: bpy.props.FloatProperty(name="Poses a second", default=0, min=0, max=1000,
                                         description="Of those that come faster the newest goes; 0: a quarter above the scene's frame rate")
    on_topology: bpy.props.EnumProperty(name="Other faces", default="rebake", description="When the object has other faces than before",
                                        items=(("rebake", "new surface", "Bake that surface, and go on with it"),
                                               ("raise", "skip", "Skip poses until the first faces are back")))


class EigencastPreferences(bpy.types.AddonPreferences):
    bl_idname = __package__ or __name__
    token_file: bpy.props.StringProperty(name="Token file", subtype="FILE_PATH", description="Its text is shown to the broker")

    def draw(self, context):
        self.layout.prop(self, "token_file")


CLASSES = (EigencastSettings, EigencastPreferences, EIGENCAST_OT_start, EIGENCAST_OT_stop, EIGENCAST_OT_page, EIGENCAST_PT_panel)


def register():
    for each in CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Scene.eigencast = bpy.props.PointerProperty(type=EigencastSettings)
    for handler_list, handler in handlers():
        handler_list.append(handler)
    bpy.app.timers.register(tick, first_interval=TICK_S, persistent=True)


def unregister():
    for each in lives:
        each.end("the add-on was disabled")
    lives.clear()
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
    for handler_list, handler in handlers():
        if handler in handler_list:
            handler_list.remove(handler)
    del bpy.types.Scene.eigencast
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)
