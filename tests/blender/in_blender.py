# SPDX-License-Identifier: MIT
"""What a test does inside Blender: installs the add-on's zip, moves objects, says what it sent. Usage, after `--`:
in_blender.py ADDON.zip SCENARIO ORIGIN FOLDER. Writes FOLDER/result.json, and FOLDER/STREAM.npy: the poses, (T, n, 3)."""
import contextlib
import io
import json
import pathlib
import statistics
import sys
import time

import bmesh
import bpy
import numpy

sys.dont_write_bytecode = True
sys.path.insert(0, str(pathlib.Path(__file__).parent))
import scenes  # noqa: E402

ZIP, SCENARIO, ORIGIN, FOLDER = sys.argv[sys.argv.index("--") + 1:]
FOLDER = pathlib.Path(FOLDER)
POSES = 60
FRAMES = 12  # In a window, which software draws.
FRAME_S = 1 / 24
AHEAD = 8  # Poses that may be under way: however loaded the machine is, the viewer keeps up.
arrived = numpy.memmap(FOLDER / "arrived", numpy.uint64, "r")


def install():
    bpy.ops.preferences.addon_install(filepath=ZIP)
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        bpy.ops.preferences.addon_enable(module="eigencast_blender")
    import eigencast_blender
    return eigencast_blender, said.getvalue()


add_on, said = install()
result = {"said": said}


def start(*targets, stream, **settings):
    for name, value in settings.items():
        setattr(bpy.context.scene.eigencast, name, value)
    bpy.context.scene.eigencast.url = f"{ORIGIN}/{stream}"
    bpy.ops.object.select_all(action="DESELECT")
    for target in targets:
        target.select_set(True)
    done = bpy.ops.eigencast.start()
    return add_on.lives[-1] if done == {"FINISHED"} else None


def eventually(condition, what):
    end = time.monotonic() + 120
    while not condition():
        if time.monotonic() > end:
            raise RuntimeError(f"it did not happen: {what}; {list(arrived)} {[each.state() for each in add_on.lives]}")
        time.sleep(0.02)


def play(target, live, poses, first=2):
    """Frames as they play in real time."""
    for frame in range(first, first + POSES):
        bpy.context.scene.frame_set(frame)
        poses.append(scenes.seen(target))
        eventually(lambda: arrived[0] + AHEAD >= len(poses), "arrival")
        time.sleep(FRAME_S)


def keep(stream, poses):
    numpy.save(FOLDER / f"{stream}.npy", numpy.array(poses, numpy.float32))


def told(live):
    stats = live.stream.stats if not live.ended else live.stats
    return {"taken": stats.poses_taken, "sent": stats.poses_sent, "early": stats.poses_early, "superseded": stats.poses_superseded,
            "dropped": stats.poses_dropped, "bakes": stats.bakes, "skipped": live.skipped, "skipped_poses": live.skipped_poses, "ended": live.ended,
            "name": live.name, "state": live.state(), "figures": live.figures()}


def streamed(target, stream, **settings):
    live = start(target, stream=stream, **settings)
    assert live.stream.wait_live(120), live.state()
    if stream == "moves":  # Has a viewer, which takes the surface first.
        eventually(lambda: arrived[1] == len(scenes.seen(target)), "the whole surface")
    return live, [scenes.seen(target)]


def moves(kind):
    target = scenes.KINDS[kind]()
    bpy.context.scene.frame_set(1)
    live, poses = streamed(target, "moves")
    play(target, live, poses)
    eventually(lambda: arrived[0] >= len(poses), "the last pose")
    keep("moves", poses)
    result.update(told(live))


def measure(side):
    """What a frame takes of Blender, (side + 1) x (side + 1) points."""
    target = scenes.shape_key(int(side))
    bpy.context.scene.frame_set(1)
    live, poses = streamed(target, "moves")
    eventually(lambda: not live.stream.stats.baking, "all of the basis")
    bpy.app.handlers.frame_change_post.remove(add_on.on_frame)
    taken_s = []

    def timed(scene, depsgraph):
        begun = time.perf_counter()
        add_on.on_frame(scene, depsgraph)
        taken_s.append(time.perf_counter() - begun)

    bpy.app.handlers.frame_change_post.append(timed)
    play(target, live, poses)
    eventually(lambda: arrived[0] >= len(poses), "the last pose")
    result.update(told(live), points=len(poses[0]), ms=1e3 * statistics.median(taken_s))


def remesh():
    target = scenes.remesh()
    bpy.context.scene.frame_set(1)
    live, _ = streamed(target, "moves")
    result["faces"] = set()
    for frame in range(2, 2 + POSES):
        bpy.context.scene.frame_set(frame)
        result["faces"].add(len(scenes.seen(target)))
        time.sleep(FRAME_S)
    assert live.stream.wait_live(120), live.state()
    keep("moves", [scenes.seen(target)])
    result["last"] = len(scenes.seen(target))
    result["faces"] = len(result["faces"])
    eventually(lambda: arrived[1] == result["last"], "the last surface")
    result.update(told(live))
    live = start(target, stream="raises", on_topology="raise")
    bpy.context.scene.frame_set(2)
    result["raises"] = told(live)


def other_faces():
    """As many points and faces as before, joined in another way."""
    target = scenes.grid(8)
    live, _ = streamed(target, "moves")
    other = bpy.data.meshes.new("other")
    corners = [tuple(reversed(polygon.vertices)) for polygon in target.data.polygons]
    other.from_pydata([vertex.co.copy() for vertex in target.data.vertices], [], corners)
    target.data = other
    bpy.context.view_layer.update()
    eventually(lambda: live.stream.stats.bakes == 2 and live.stream.wait_live(1), "the other surface")
    result.update(told(live))


def life():
    """Renamed, hidden, undone, edited, deleted."""
    target = scenes.shape_key()
    bpy.ops.ed.undo_push(message="made")
    live, poses = streamed(target, "moves", url="")
    target.name = "Another"
    play(target, live, poses)
    bpy.ops.ed.undo_push(message="renamed")
    target.location.x += 1
    bpy.ops.ed.undo_push(message="moved")
    poses.append(scenes.seen(target))
    time.sleep(FRAME_S)
    bpy.ops.ed.undo()
    target = live.target()
    poses.append(scenes.seen(target))
    result["undone"] = told(live)
    play(target, live, poses, first=2 + POSES)
    eventually(lambda: arrived[0] >= len(poses), "the last pose")
    target.hide_set(True)
    bpy.context.scene.frame_set(3)
    result["hidden"] = told(live)
    target.hide_set(False)
    bpy.context.scene.frame_set(4)
    poses.append(scenes.seen(target))
    result["shown"] = told(live)
    eventually(lambda: arrived[0] >= len(poses), "the pose after it was hidden")
    bpy.context.view_layer.objects.active = target
    bpy.ops.object.mode_set(mode="EDIT")
    poses.append(scenes.seen(target))  # Modes show shape keys differently.
    edited = bmesh.from_edit_mesh(target.data)
    for vertex in edited.verts:
        vertex.co.z += 1
    bmesh.update_edit_mesh(target.data)
    bpy.context.view_layer.update()
    poses.append(scenes.seen(target))
    bpy.ops.object.mode_set(mode="OBJECT")
    poses.append(scenes.seen(target))
    eventually(lambda: arrived[0] >= len(poses), "the poses that were edited")
    bpy.data.objects.remove(target)
    bpy.context.view_layer.update()
    result["deleted"] = told(live)
    bpy.context.scene.frame_set(5)
    keep("moves", poses)
    # By its operator, and found without an update.
    live, _ = streamed(scenes.grid(4), "removed")
    bpy.ops.object.delete()
    add_on.tick()
    result["removed"] = told(live)


def load():
    """Another file ends streams, and new ones go on."""
    first, _ = streamed(scenes.grid(4), "first")
    path = str(FOLDER / "saved.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    result["first"] = told(first)
    target = scenes.shape_key()
    bpy.context.scene.frame_set(1)
    live, poses = streamed(target, "moves")
    play(target, live, poses)
    eventually(lambda: arrived[0] >= len(poses), "the last pose")
    keep("moves", poses)
    result.update(told(live))


def refusals():
    """What cannot be streamed, and why; nothing waits for a broker that is not there."""
    bpy.ops.object.camera_add()
    camera = bpy.context.object
    wire = bpy.data.objects.new("Wire", bpy.data.meshes.new("wire"))
    wire.data.from_pydata([(0, 0, 0), (1, 0, 0)], [(0, 1)], [])
    bpy.context.collection.objects.link(wire)
    a, b = scenes.grid(4), scenes.grid(5)
    problems = {}
    for name, targets, stream in (("camera", [camera], "camera"), ("two", [a, b], "same"), ("name", [a], "no name")):
        try:
            start(*targets, stream=stream)
            problems[name] = ""
        except RuntimeError as error:  # What operators report.
            problems[name] = str(error)
    result["problems"] = problems
    result["wire"] = told(start(wire, stream="wire"))
    assert bpy.ops.eigencast.stop(number=len(add_on.lives) - 1) == {"FINISHED"}
    for live in list(add_on.lives):
        bpy.ops.eigencast.stop(number=0)
    start(a, b, stream="{object}")
    result["urls"] = [live.url[len(ORIGIN):] for live in add_on.lives]
    bpy.context.scene.eigencast.url = "http://127.0.0.1:9/nobody"
    bpy.ops.eigencast.stop(number=0)
    bpy.ops.eigencast.stop(number=0)
    b.select_set(False)
    bpy.ops.eigencast.start()
    for frame in range(POSES):
        bpy.context.scene.frame_set(frame)
    eventually(lambda: add_on.lives[0].stream.stats.bakes == 1, "its bake")
    add_on.tick()
    result["nobody"] = told(add_on.lives[0])
    bpy.ops.preferences.addon_disable(module="eigencast_blender")
    lists = bpy.app.handlers
    result["left"] = [str(each) for each in (*lists.frame_change_post, *lists.depsgraph_update_post, *lists.load_pre, *lists.undo_post)
                      if "eigencast" in each.__module__]


def still():
    """Stands still while the broker is another one; timers do not run without a window."""
    live, _ = streamed(scenes.grid(8), "moves")
    (FOLDER / "stands").touch()

    def seen_again():
        add_on.tick()
        return (FOLDER / "again").exists()

    eventually(seen_again, "a viewer of the other broker")
    result.update(told(live))


def window():
    """In a window: the timeline plays by itself, the panel is drawn."""
    target = scenes.shape_key(end=FRAMES)
    bpy.context.scene.frame_set(1)
    live, poses = streamed(target, "moves")
    frames = []

    def count(scene, depsgraph):
        frames.append(scene.frame_current)
        poses.append(scenes.seen(target))

    panels = []
    panel = add_on.EIGENCAST_PT_panel
    draw = panel.draw

    def drawn(self, context):
        draw(self, context)
        panels.append([live.state()[1], *live.figures()])

    # No script chooses the sidebar's tab: the panel goes to the first one.
    bpy.utils.unregister_class(panel)
    panel.bl_category, panel.draw = "Item", drawn
    bpy.utils.register_class(panel)
    for area in bpy.context.window_manager.windows[0].screen.areas:
        if area.type == "VIEW_3D":
            area.spaces.active.show_region_ui = True

    def end():
        if len(frames) < FRAMES or not panels:
            return 0.05
        if bpy.context.screen.is_animation_playing:
            bpy.ops.screen.animation_cancel(restore_frame=False)
            return 0.5
        if arrived[0] < len(poses):
            return 0.05
        keep("moves", poses)
        result.update(told(live), frames=len(frames), panel=panels[-1])
        finish()
        bpy.ops.wm.quit_blender()

    bpy.app.handlers.frame_change_post.append(count)
    bpy.app.timers.register(lambda: bpy.ops.screen.animation_play() and None, first_interval=0.5)
    bpy.app.timers.register(end, first_interval=1)


def finish():
    (FOLDER / "result.json").write_text(json.dumps(result))


for each in list(bpy.data.objects):
    bpy.data.objects.remove(each)
scenario, _, argument = SCENARIO.partition(":")
globals()[scenario](*filter(None, [argument]))
if scenario != "window":
    finish()
