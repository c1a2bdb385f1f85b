# SPDX-License-Identifier: GPL-3.0-or-later
"""Sculpting live in a real Blender's window, with mouse and keys as a person uses them."""

import os
from pathlib import Path
from typing import Any

import pytest

from tactile_clay.clay_addon.core.tracking.recording.recording import Recorder
from tactile_clay.tests.clay_addon.core.tracking.hands import MILLISECOND, frame_at

STEPS = (Path(__file__).parent / "window_steps.py").read_text(encoding="utf-8")
COMMON = """
import importlib
import sys

import numpy as np

MODULE = "bl_ext.user_default.tactile_clay"
ARGUMENTS = sys.argv[sys.argv.index("--") + 1:]
bpy.ops.preferences.addon_enable(module=MODULE)
sculpting = importlib.import_module(MODULE + ".clay_addon.sculpt.live.current").current

def clay():
    return bpy.data.objects["Clay"]

def points():
    item = clay()
    values = np.empty((len(item.data.points), 3), np.float32)
    item.data.attributes["position"].data.foreach_get("vector", values.ravel())
    return values + np.array(item.matrix_world.translation)

def top():
    found = points()
    return float(found[np.hypot(found[:, 0], found[:, 1]) < 0.012, 2].max())

def make_block(size=0.06, spacing=0.006):
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.context.preferences.view.show_splash = False
    with in_view():
        bpy.ops.mesh.primitive_cube_add(size=size, location=(0.0, 0.0, 0.5 * size))
        bpy.context.scene.tactile_clay_sculpt.strength = 1.0
        assert bpy.ops.clay.make(spacing=spacing) == {"FINISHED"}
        bpy.ops.mesh.primitive_plane_add(size=0.4)
        assert bpy.ops.clay.collider_add() == {"FINISHED"}
        bpy.ops.object.select_all(action="DESELECT")
        bpy.ops.view3d.view_axis(type="TOP")
        bpy.context.space_data.region_3d.view_distance = 0.3
        bpy.ops.ed.undo_push(message="Block")

def start():
    with in_view():
        assert bpy.ops.clay.sculpt("INVOKE_DEFAULT") == {"RUNNING_MODAL"}

def moves():
    running = sculpting.session
    return running is not None and running.pace.started

def after(seconds):
    # Simulated time, which is what tools and clay go by.
    running = sculpting.session
    until = running.pace.simulated + seconds
    return lambda: running.pace.simulated >= until

def press(place, seconds=0.6):
    move(on_screen(place))
    yield after(0.05)
    event("LEFTMOUSE")
    yield after(seconds)
    event("LEFTMOUSE", "RELEASE")
    state = clay().data.get("clay_state")
    yield lambda: clay().data.get("clay_state") != state
"""
STROKES = """
def steps():
    make_block()
    yield 0.5
    before = top()
    start()
    yield moves
    yield from press((0.0, 0.0, 0.06))
    first = top()
    print("DENTED", before - first > 0.004, before, first, flush=True)
    # Turning the view is Blender's business, also while sculpting.
    view_before = view()[1].spaces.active.region_3d.view_rotation.copy()
    key("NUMPAD_1")
    region = view()[1].spaces.active.region_3d
    yield lambda: region.view_rotation.rotation_difference(view_before).angle > 1.0
    yield lambda: not region.is_orthographic_side_view or True
    with in_view():
        bpy.ops.view3d.view_axis(type="TOP")
    yield after(0.3)
    yield from press((0.0, 0.0, first))
    second = top()
    print("DEEPER", first - second > 0.002, second, flush=True)
    screenshot(ARGUMENTS[0])
    key("Z", ctrl=True)
    yield lambda: clay().data.get("clay_state") == 1
    yield after(0.2)
    print("UNDONE", abs(top() - first) < 0.001, sculpting.session is not None, flush=True)
    key("Z", ctrl=True, shift=True)
    yield lambda: clay().data.get("clay_state") == 2
    yield after(0.2)
    print("REDONE", abs(top() - second) < 0.001, flush=True)
    bpy.ops.wm.save_as_mainfile(filepath=ARGUMENTS[1])
    key("ESC")
    yield lambda: sculpting.session is None
    # Back to before the session, a step at a time.
    for _ in range(2):
        state = clay().data["clay_state"]
        key("Z", ctrl=True)
        yield lambda: clay().data.get("clay_state") != state
    assert clay().data.get("clay_state") is None, "an undo step too many"
    # What Undo leaves to do waits for a timer.
    yield lambda: abs(top() - before) < 1e-5
    print("BACK", abs(top() - before) < 1e-5, flush=True)

run(steps())
"""
STRESS = """
import random

def steps():
    chance = random.Random(int(ARGUMENTS[1]))
    make_block(size=0.05, spacing=0.008)
    yield 0.5
    start()
    yield moves
    done = {}
    for _ in range(int(ARGUMENTS[2])):
        kind = chance.choice(
            ["stroke"] * 5 + ["undo"] * 4 + ["redo"] * 2
            + ["turn", "rename", "save", "mode", "move"]
        )
        done[kind] = done.get(kind, 0) + 1
        print("STEP", kind, flush=True)
        if sculpting.session is None:
            start()
            yield moves
        if kind == "stroke":
            move(on_screen((chance.uniform(-0.015, 0.015), chance.uniform(-0.015, 0.015), 0.05)))
            yield after(0.05)
            event("LEFTMOUSE")
            yield after(chance.uniform(0.1, 0.3))
            event("LEFTMOUSE", "RELEASE")
        elif kind == "undo":
            for _ in range(chance.randint(1, 4)):
                key("Z", ctrl=True)
                yield chance.choice((0.02, 0.3))
        elif kind == "redo":
            for _ in range(chance.randint(1, 3)):
                key("Z", ctrl=True, shift=True)
                yield chance.choice((0.02, 0.3))
        elif kind == "turn":
            key(chance.choice(("NUMPAD_4", "NUMPAD_6", "NUMPAD_7")))
        elif kind == "rename":
            with in_view():
                item = bpy.context.scene.objects.get("Plane")
                if item is not None:
                    item.data.name = chance.choice(("one", "two"))
                    bpy.ops.ed.undo_push(message="Rename")
        elif kind == "save":
            bpy.ops.wm.save_as_mainfile(filepath=ARGUMENTS[0])
        elif kind == "mode":
            key("ESC")
            yield lambda: sculpting.session is None
            with in_view():
                item = bpy.context.scene.objects.get("Plane")
                if item is not None:
                    bpy.context.view_layer.objects.active = item
                    bpy.ops.object.mode_set(mode="EDIT")
                    bpy.ops.object.mode_set(mode="OBJECT")
        elif kind == "move":
            move(on_screen((chance.uniform(-0.05, 0.05), chance.uniform(-0.05, 0.05), 0.0)))
        yield chance.choice((0.05, 0.4))
        # Undo far enough takes the block itself away, and with it the session.
        if "Clay" not in bpy.data.objects:
            print("GONE", flush=True)
            if sculpting.session is not None:
                key("ESC")
                yield lambda: sculpting.session is None
            make_block(size=0.05, spacing=0.008)
            yield 0.3
    assert np.isfinite(points()).all()
    print("DONE", done, flush=True)
    print("SURVIVED", ARGUMENTS[2], flush=True)

run(steps())
"""
REOPENED = """
import bpy
import numpy as np

bpy.ops.preferences.addon_enable(module="bl_ext.user_default.tactile_clay")
import importlib
autosave = importlib.import_module(
    "bl_ext.user_default.tactile_clay.clay_addon.sculpt.live.autosave"
)
import sys
path = sys.argv[sys.argv.index("--") + 1]
bpy.ops.wm.open_mainfile(filepath=path)
item = bpy.data.objects["Clay"]
values = np.empty((len(item.data.points), 3), np.float32)
for name in ("position", "rest_position"):
    item.data.attributes[name].data.foreach_get("vector", values.ravel())
    found = values + np.array(item.matrix_world.translation)
    near = np.hypot(found[:, 0], found[:, 1]) < 0.012
    print("TOP", name, round(float(found[near, 2].max()), 4))
print("MESSAGE", autosave.recovery.message)
"""
KILLED = """
import signal

def steps():
    make_block()
    bpy.ops.wm.save_as_mainfile(filepath=ARGUMENTS[0])
    yield 0.5
    start()
    yield moves
    yield from press((0.0, 0.0, 0.06))
    dented = top()
    beside = ARGUMENTS[0] + ".clay-autosave.npz"
    yield lambda: os.path.exists(beside)
    print("DENTED TO", round(dented, 4), flush=True)
    os.kill(os.getpid(), signal.SIGKILL)

run(steps())
"""
INTERRUPTED = """
import threading

def threads():
    return sorted(t.name for t in threading.enumerate() if t.name.startswith(("clay-", "clay ")))

def handlers():
    lists = [getattr(bpy.app.handlers, name) for name in dir(bpy.app.handlers)]
    return sum(len(found) for found in lists if isinstance(found, list))

def steps():
    make_block()
    bpy.ops.wm.save_as_mainfile(filepath=ARGUMENTS[0])
    handlers_before = handlers()
    yield 0.5
    start()
    yield moves
    # Another file in the middle of it.
    bpy.ops.wm.open_mainfile(filepath=ARGUMENTS[0])
    yield 0.5
    yield lambda: not threads()
    print("FILE", sculpting.session, threads(), handlers() == handlers_before, flush=True)
    start()
    yield moves
    # What a person may do in the outliner meanwhile; in the view a surface stands for the clay.
    other = clay().copy()
    other.data = clay().data.copy()
    other.location.x += 0.1
    bpy.context.scene.collection.objects.link(other)
    yield lambda: [part.count for part in sculpting.session.simulation.parts] == [1000, 1000]
    yield after(0.1)
    other.name = "Other"
    yield lambda: sculpting.session.simulation.parts[1].name == "Other"
    other.hide_viewport = True
    yield lambda: len(sculpting.session.simulation.parts) == 1
    yield after(0.1)
    other.hide_viewport = False
    yield lambda: len(sculpting.session.simulation.parts) == 2
    other.hide_set(True)
    yield after(0.1)
    bpy.data.objects.remove(other)
    yield lambda: len(sculpting.session.simulation.parts) == 1
    yield after(0.1)
    print("CLAY CAME AND WENT", flush=True)
    # The extension switched off in the middle of it.
    bpy.ops.preferences.addon_disable(module=MODULE)
    yield 0.5
    yield lambda: not threads()
    print("OFF", sculpting.session, threads(), hasattr(bpy.types.Scene, "tactile_clay"), flush=True)
    bpy.ops.preferences.addon_enable(module=MODULE)
    current = importlib.import_module(MODULE + ".clay_addon.sculpt.live.current")
    globals()["sculpting"] = current.current
    yield 0.5
    start()
    yield moves
    bpy.data.objects.remove(clay())
    yield lambda: sculpting.session is None
    yield lambda: not threads()
    print("NO CLAY LEFT", threads(), flush=True)

run(steps())
"""

HANDS = """
def steps():
    make_block()
    clay().location.y += 0.08
    with in_view():
        assert bpy.ops.clay.hand_add(side="RIGHT") == {"FINISHED"}
        bpy.ops.view3d.view_all()
    bpy.context.view_layer.update()
    properties = bpy.context.scene.tactile_clay_tracking
    properties.source, properties.recording = "RECORDING", ARGUMENTS[0]
    live = importlib.import_module(MODULE + ".clay_addon.tracking.live")
    before = float(points()[:, 2].max())
    bpy.context.scene.tactile_clay_sculpt.tool = "NONE"
    with in_view():
        assert bpy.ops.clay.tracking_start() == {"FINISHED"}
    def seen():
        hand = live.tracking.session.hand("right")
        return hand is not None and hand.contact == 1.0
    yield seen
    start()
    yield moves
    yield lambda: sculpting.session.hand_force > 1.0
    print("FELT", flush=True)
    yield lambda: before - float(points()[:, 2].max()) > 0.006
    screenshot(ARGUMENTS[1])
    print("PRESSED", len(sculpting.session.simulation.hands), flush=True)
    key("ESC")
    yield lambda: sculpting.session is None
    with in_view():
        bpy.ops.clay.tracking_stop()
    print("KEPT", before - float(points()[:, 2].max()) > 0.005, "clay_sculpted" in clay().data)

run(steps())
"""

NEW_USER = """
def steps():
    with in_view():
        assert bpy.ops.clay.kindergarten_scene_add() == {"FINISHED"}
    yield 0.5
    window, area, region = view()
    area.spaces.active.show_region_ui = True
    yield 0.5
    panels = next(r for r in area.regions if r.type == "UI")
    panels.active_panel_category = "Clay"
    item = next(i for i in bpy.context.scene.objects if i.tactile_clay.role == "CLAY")
    name = item.name
    globals()["clay"] = lambda: bpy.data.objects[name]
    assert len(item.data.points) == 2114
    bpy.ops.ed.undo_push(message="Scene")
    start()
    yield moves
    yield after(0.3)
    before = points()
    # The top of the piece that stands highest.
    place = before[before[:, 2].argmax()]
    move(on_screen(place))
    yield after(0.05)
    event("LEFTMOUSE")
    yield after(0.5)
    screenshot(ARGUMENTS[0])
    event("LEFTMOUSE", "RELEASE")
    yield lambda: clay().data.get("clay_state") == 1
    pressed = points()
    near = np.linalg.norm(before - place, axis=1) < 0.012
    moved = float(np.linalg.norm(pressed - before, axis=1)[near].max())
    print("PRESSED", moved > 0.003, flush=True)
    # Turning the view with the middle button.
    rotation = area.spaces.active.region_3d.view_rotation.copy()
    middle = region.x + region.width // 3, region.y + region.height // 3
    move(middle)
    event("MIDDLEMOUSE")
    for step in range(6):
        move((middle[0] + 15 * step, middle[1]))
        yield 0.1
    event("MIDDLEMOUSE", "RELEASE")
    region_3d = area.spaces.active.region_3d
    yield lambda: region_3d.view_rotation.rotation_difference(rotation).angle > 0.05
    print("TURNED", sculpting.session is not None, flush=True)
    key("Z", ctrl=True)
    yield lambda: clay().data.get("clay_state") is None
    yield after(0.1)
    print("UNDONE", float(np.abs(points() - before).max()) < 0.003, flush=True)
    key("Z", ctrl=True, shift=True)
    yield lambda: clay().data.get("clay_state") == 1
    yield after(0.1)
    print("REDONE", float(np.abs(points() - pressed).max()) < 0.003, flush=True)
    bpy.ops.wm.save_as_mainfile(filepath=ARGUMENTS[1])
    key("ESC")
    yield lambda: sculpting.session is None
    screenshot(ARGUMENTS[2])
    print("STANDS FOR IT", [i.name for i in bpy.data.objects if "Live" in i.name], flush=True)

run(steps())
"""


@pytest.fixture
def window(blender_with_extension: Any) -> Any:
    """A real Blender whose scripts may use the steps of a person."""

    def run(script: str, *arguments: Path | str) -> Any:
        return blender_with_extension.run_script(
            STEPS + COMMON + script, *arguments, window=True, timeout=600.0
        )

    return run


def test_strokes_are_undone_redone_saved_and_taken_back(
    window: Any, blender_with_extension: Any
) -> None:
    """Press twice and turn the view, undo, redo, save, finish, and undo the session."""
    folder = blender_with_extension.folder
    picture, file = folder / "sculpting.png", folder / "sculpted.blend"
    result = window(STROKES, picture, file)
    assert result.exit_code == 0, result.output
    for line in ("DENTED True", "DEEPER True", "UNDONE True True", "REDONE True", "BACK True"):
        assert line in result.output, result.output
    assert picture.stat().st_size > 20_000
    assert not list(folder.glob("*autosave*"))


@pytest.mark.parametrize("seed", range(int(os.environ.get("UNDO_SEEDS", "1"))))
def test_any_order_of_strokes_undos_and_redos_is_survived(
    window: Any, blender_with_extension: Any, seed: int
) -> None:
    """Stroke, undo, redo, turn the view, rename, save and switch modes in random order.

    ``UNDO_SEEDS`` says how many orders to try, ``UNDO_STEPS`` how long each is.
    """
    file = blender_with_extension.folder / f"stress_{seed}.blend"
    steps = os.environ.get("UNDO_STEPS", "20")
    result = window(STRESS, file, str(seed), steps)
    assert result.exit_code == 0, result.output
    assert f"SURVIVED {steps}" in result.output, result.output
    assert "Traceback" not in result.output, result.output


def test_clay_of_a_session_that_was_killed_is_there_again(
    window: Any, blender_with_extension: Any
) -> None:
    """Kill Blender right after a stroke, and find the stroke in the file when it is opened."""
    file = blender_with_extension.folder / "killed.blend"
    result = window(KILLED, file)
    assert "DENTED TO" in result.output, result.output
    dented = float(result.output.split("DENTED TO")[1].split()[0])
    assert dented < 0.055
    found = blender_with_extension.run_script(REOPENED, file)
    assert found.exit_code == 0, found.output
    for name in ("position", "rest_position"):
        assert float(found.output.split(f"TOP {name}")[1].split()[0]) == pytest.approx(
            dented, abs=0.001
        )
    assert "The last session was interrupted. Clay was recovered" in found.output


def test_a_session_ends_cleanly_whatever_happens_to_it(
    window: Any, blender_with_extension: Any
) -> None:
    """Open a file, change and delete clay, and switch the extension off, all while sculpting."""
    result = window(INTERRUPTED, blender_with_extension.folder / "block.blend")
    assert result.exit_code == 0, result.output
    assert "FILE None [] True" in result.output, result.output
    assert "CLAY CAME AND WENT" in result.output
    assert "OFF None [] False" in result.output, result.output
    assert "NO CLAY LEFT []" in result.output


def test_a_tracked_hand_presses_the_clay(window: Any, blender_with_extension: Any) -> None:
    """Play a recorded hand to the session from another process, and let it flatten a block."""
    folder = blender_with_extension.folder
    recording, picture = folder / "press.jsonl", folder / "hand.png"
    recorder = Recorder(recording)
    for number in range(600):
        height = 0.16 - 0.14 * min(1.0, max(0.0, (number - 50) / 400))
        frame = frame_at(number, number, at=(0.0, height, 0.0))
        recorder.take(frame, number * 10 * MILLISECOND)
    recorder.close()
    result = window(HANDS, recording, picture)
    assert result.exit_code == 0, result.output
    assert "PRESSED 1" in result.output, result.output
    assert "FELT" in result.output, result.output
    assert "KEPT True True" in result.output, result.output


def test_a_new_user_sculpts_the_kindergarten(window: Any, blender_with_extension: Any) -> None:
    """Add the scene, press a piece, turn the view meanwhile, undo, redo, save and finish."""
    folder = blender_with_extension.folder
    file = folder / "kindergarten.blend"
    result = window(NEW_USER, folder / "pressing.png", file, folder / "done.png")
    assert result.exit_code == 0, result.output
    for line in ("PRESSED True", "TURNED True", "UNDONE True", "REDONE True", "STANDS FOR IT []"):
        assert line in result.output, result.output
    assert file.is_file()
