# SPDX-License-Identifier: GPL-3.0-or-later
"""Recording, playing and recovering takes."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from tactile_clay.clay_addon.core.storage import atomic_files as cache_files
from tactile_clay.clay_addon.core.storage.cache import Cache, CacheError
from tactile_clay.clay_addon.core.take.files import read_take
from tactile_clay.clay_addon.core.tools.edits import Edit
from tactile_clay.clay_addon.core.tools.settings import ToolMesh
from tactile_clay.clay_addon.model.cache_folder import resolve_directory
from tactile_clay.clay_addon.simulate.simulation import Simulation
from tactile_clay.clay_addon.take.recorder import TakeError, TakeRecorder
from tactile_clay.clay_addon.take.store import store_take, take_edits, take_start
from tactile_clay.tests.experiments.shapes import ball

from .takes import STEP, TOP, Loop, press, pressed, record_press, studio_scene


@pytest.mark.parametrize("rate", [24, 60])
def test_take_plays_as_recorded(studio: Any, tmp_path: Path, rate: int) -> None:
    """At each frame the clay and the tool are as they were at that time."""
    clay, item = studio_scene(studio, tmp_path, rate=rate)
    start = studio.points(clay)
    loop = Loop(studio.scene)
    record_press(loop, item, 0.5)
    stored = loop.finish()
    scene = studio.scene
    last = 1 + round(0.5 * rate)
    assert (stored.first, stored.last) == (scene.frame_start, scene.frame_end) == (1, last)
    assert scene.frame_current == last
    assert scene.tactile_clay.cache_directory.startswith("//clay_cache_take_001")
    for frame in range(1, last + 1):
        scene.frame_set(frame)
        step = (frame - 1) / rate / STEP
        before, fraction = loop.shapes[int(step)], step - int(step)
        after = loop.shapes[min(int(step) + 1, len(loop.shapes) - 1)]
        shown = studio.points(clay)
        np.testing.assert_allclose(shown, before + fraction * (after - before), atol=1e-7)
        wanted = press((frame - 1) / rate)
        # Between two steps the tool moves linearly.
        assert (item.matrix_world.translation - wanted.translation).length < 1e-4
        assert item.tactile_clay.collider_enabled == pressed((frame - 1) / rate)
    np.testing.assert_allclose(shown, loop.shapes[-1], atol=1e-7)
    kept = take_start(clay)
    assert kept is not None
    np.testing.assert_allclose(kept[0], start, atol=1e-7)


def test_a_take_that_cannot_begin_leaves_no_thread(
    studio: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The writer thread ends if the folder cannot be written to."""
    studio_scene(studio, tmp_path, rate=60)

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tactile_clay.clay_addon.take.recorder.write_start", full)
    with pytest.raises(TakeError, match="No space left"):
        Loop(studio.scene)
    assert not [each for each in threading.enumerate() if each.name == "clay-take"]


def test_take_survives_saving_and_loading(studio: Any, tmp_path: Path) -> None:
    """The .blend stores the keyframes, the folder of the frames and the initial clay."""
    clay, item = studio_scene(studio, tmp_path, rate=60)
    loop = Loop(studio.scene)
    record_press(loop, item, 0.2)
    loop.finish()
    path = studio.save(tmp_path)
    bpy.ops.wm.open_mainfile(filepath=str(path))
    clay, item = bpy.data.objects["Clay"], bpy.data.objects["Ball"]
    kept = take_start(clay)
    assert kept is not None
    np.testing.assert_allclose(kept[0], loop.shapes[0], atol=1e-7)
    studio.scene.frame_set(7)
    np.testing.assert_allclose(studio.points(clay), loop.shapes[6], atol=1e-7)
    assert (item.matrix_world.translation - press(0.1).translation).length < 1e-6


def test_only_objects_that_moved_or_may_move_get_keys(studio: Any, tmp_path: Path) -> None:
    """A table gets no keys; an object with an old action gets keys that hold it still."""
    _, item = studio_scene(studio, tmp_path, rate=60)
    item.location.z = 0.2
    for frame, x in ((1, 0.0), (50, 1.0)):
        item.location.x = x
        item.keyframe_insert("location", frame=frame)
    before = item.animation_data.action
    studio.scene.frame_set(1)
    loop = Loop(studio.scene)
    for _ in range(6):
        loop.step()
    stored = loop.finish()
    assert stored.objects == ("Ball",)
    assert bpy.data.objects["Table"].animation_data is None
    assert before.use_fake_user and item.animation_data.action != before
    studio.scene.frame_set(7)
    assert item.matrix_world.translation.x == pytest.approx(0.0, abs=1e-6)


def test_tool_that_moves_with_its_parent_is_followed(studio: Any, tmp_path: Path) -> None:
    """Only the parent that moved is keyed, and moves the tool."""
    _, item = studio_scene(studio, tmp_path, rate=60)
    handle = bpy.data.objects.new("Handle", None)
    studio.scene.collection.objects.link(handle)
    item.parent = handle
    item.matrix_parent_inverse = Matrix.Translation((0.0, 0.0, 0.3))
    bpy.context.view_layer.update()
    start = item.matrix_world.copy()
    loop = Loop(studio.scene)
    for number in range(1, 7):
        handle.location.x = 0.01 * number
        loop.step()
    assert loop.finish().objects == ("Handle",)
    studio.scene.frame_set(4)
    moved = item.matrix_world.translation - start.translation
    assert moved.x == pytest.approx(0.03, abs=1e-6)


def test_mouse_tool_becomes_a_collider_with_keys(studio: Any, tmp_path: Path) -> None:
    """A tool moved with the mouse becomes a collider, enabled while it touched the clay."""
    _, item = studio_scene(studio, tmp_path, rate=60)
    bpy.data.objects.remove(item)
    studio.scene.unit_settings.scale_length = 0.5
    loop = Loop(studio.scene)
    shape = ball(0.01)
    faces = np.asarray(shape.faces, np.int32)
    small = ToolMesh(np.asarray(shape.vertices), faces, 0.3)
    never = ToolMesh(2.0 * np.asarray(shape.vertices), faces, 0.3)
    for number in range(1, 13):
        held = [] if number in (6, 7) else [small] if number < 10 else [never]
        loop.recorder.use_tools(held)
        pose = np.eye(4)
        pose[:3, 3] = (0.0, 0.0, 0.3 - 0.01 * number)
        loop.step(tools=[(pose, 3 <= number < 10) for _ in held])
    (name,) = loop.finish().objects
    tool = bpy.data.objects[name]
    assert tool.tactile_clay.role == "COLLIDER"
    assert tool.tactile_clay.collider_friction == pytest.approx(0.3)
    assert tool.dimensions.x == pytest.approx(0.04, rel=0.02)
    felt = []
    for frame in range(1, 14):
        studio.scene.frame_set(frame)
        felt.append(tool.tactile_clay.collider_enabled)
        if 2 <= frame < 11:
            height = 2.0 * (0.3 - 0.01 * (frame - 1))
            assert tool.matrix_world.translation.z == pytest.approx(height, abs=1e-5)
    assert felt == [frame in (4, 5, 6, 9, 10) for frame in range(1, 14)]
    # The collider does not affect the next session, and the next take replaces it.
    studio.scene.frame_set(6)
    again = Loop(studio.scene)
    assert again.simulation.solver is not None
    assert len(again.simulation.solver.scene.meshes) == 0
    again.recorder.use_tools([small])
    again.step(tools=[(np.eye(4), True)])
    (other,) = again.finish().objects
    assert [item.name for item in bpy.data.collections["Take Tools"].objects] == [other]


def test_undone_strokes_are_not_in_the_take(studio: Any, tmp_path: Path) -> None:
    """After Undo, poses, edits and frames continue from the earlier state."""
    clay, item = studio_scene(studio, tmp_path, rate=60)
    loop = Loop(studio.scene)
    record_press(loop, item, 0.1)
    mark, state, kept = loop.recorder.mark(), loop.simulation.snapshot(), len(loop.shapes)
    loop.recorder.edit("paint", {"center": np.zeros(3), "radius": 0.01})
    for _ in range(12):
        item.matrix_world = Matrix.Translation((0.5, 0.0, 0.5))
        loop.step()
    loop.simulation.restore(state)
    loop.shapes = loop.shapes[:kept]
    loop.recorder.rewind(mark, loop.simulation)
    for _ in range(4):
        item.matrix_world = Matrix.Translation((-0.5, 0.0, 0.5))
        loop.step()
    assert loop.finish().last == 11
    frames = Cache(resolve_directory(studio.scene)).frames()
    assert frames == list(range(1, 12))
    assert take_edits(studio.scene) == []
    for frame, x in ((7, press(0.1).translation.x), (8, -0.5), (11, -0.5)):
        studio.scene.frame_set(frame)
        assert item.matrix_world.translation.x == pytest.approx(x, abs=1e-6)
        np.testing.assert_allclose(studio.points(clay), loop.shapes[frame - 1], atol=1e-7)


def test_particles_to_be_added_are_shown_at_others_before(studio: Any, tmp_path: Path) -> None:
    """Frames before an edit are played with the number of particles after it."""
    clay, _ = studio_scene(studio, tmp_path, rate=60)
    loop = Loop(studio.scene)
    for _ in range(4):
        loop.step()
    before = len(clay.data.points)
    loop.edit(Edit("add", (0.0, 0.0, TOP), 0.012))
    for _ in range(4):
        loop.step()
    loop.finish()
    assert len(loop.shapes[-1]) > before + 10
    for frame in range(1, 10):
        studio.scene.frame_set(frame)
        shown = studio.points(clay)
        assert len(shown) == len(loop.shapes[-1])
        if frame < 5:
            np.testing.assert_allclose(shown[:before], loop.shapes[frame - 1], atol=1e-7)
            assert shown[:, 2].max() < TOP
    assert shown[:, 2].max() > TOP
    (edit,) = take_edits(studio.scene)
    assert edit.kind == "add" and edit.time == pytest.approx(4 * STEP)
    assert not list(resolve_directory(studio.scene).glob("part_*"))


def test_full_disk_loses_only_frames_of_the_clay(
    studio: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The problem is reported during the recording; unwritten motion still gets keys."""
    _, item = studio_scene(studio, tmp_path, rate=60)
    loop = Loop(studio.scene)
    record_press(loop, item, 0.1)

    def refuse(path: Path, *_: object, **__: object) -> None:
        raise CacheError(f"The disk is full: {path.name} could not be written.")

    monkeypatch.setattr(cache_files, "write_atomically", refuse)
    monkeypatch.setattr("tactile_clay.clay_addon.core.take.files.write_atomically", refuse)
    for number in range(7, 13):
        item.matrix_world = press(number * STEP)
        loop.step()
    stored = loop.finish()
    assert "The disk is full" in loop.recorder.problem
    assert any("The disk is full" in warning for warning in stored.warnings)
    studio.scene.frame_set(13)
    assert (item.matrix_world.translation - press(0.2).translation).length < 1e-6


def test_take_of_no_steps_is_refused(studio: Any, tmp_path: Path) -> None:
    """A take without steps is refused and makes no keys."""
    _, item = studio_scene(studio, tmp_path, rate=60)
    loop = Loop(studio.scene)
    with pytest.raises(TakeError, match="Nothing was recorded"):
        loop.finish()
    assert item.animation_data is None


def test_unsaved_file_and_other_clay_are_refused(studio: Any, tmp_path: Path) -> None:
    """A take needs a saved .blend, and the same clay objects throughout."""
    clay = studio.clay()
    simulation = Simulation(bpy.context, live=True)
    simulation.start(bpy.context.evaluated_depsgraph_get(), "cpu")
    with pytest.raises(TakeError, match="never saved"):
        TakeRecorder.begin(studio.scene, simulation)
    studio.save(tmp_path)
    recorder = TakeRecorder.begin(studio.scene, simulation)
    clay.name = "Other"
    with pytest.raises(TakeError, match="added, renamed or deleted"):
        recorder.rebuilt(Simulation(bpy.context, live=True))
    with pytest.raises(TakeError, match="Nothing was recorded"):
        recorder.finish(studio.scene)


def test_recovering_needs_a_take(studio: Any, tmp_path: Path) -> None:
    """A folder without a valid take is refused."""
    studio.clay()
    message = studio.refused(bpy.ops.clay.take_recover, directory=str(tmp_path))
    assert "There is no take in" in message
    (tmp_path / "take.json").write_text("{}")
    message = studio.refused(bpy.ops.clay.take_recover, directory=str(tmp_path))
    assert "is damaged" in message


_KILLED = """
import time
import bpy
import tactile_clay
tactile_clay.register()
bpy.ops.wm.open_mainfile(filepath={blend!r})
from tactile_clay.tests.clay_addon.take.takes import Loop, press, STEP
loop = Loop(bpy.context.scene)
item = bpy.data.objects["Ball"]
for number in range(1, 10_000):
    item.matrix_world = press(number * STEP)
    loop.step()
    if number == 150:
        # The disk may be slow.
        while not all((loop.recorder.directory / name).exists() for name in {names!r}):
            time.sleep(0.01)
        print("on", flush=True)
"""


def test_killed_take_is_read_up_to_its_last_seconds(studio: Any, tmp_path: Path) -> None:
    """A take can be recovered from the files of a killed process."""
    _, item = studio_scene(studio, tmp_path, rate=60)
    blend = str(tmp_path / "scene.blend")
    code = _KILLED.format(blend=blend, names=("take_000000.npz", "frame_000121.npz"))
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert process.stdout is not None
    while (line := process.stdout.readline()) and line.strip() != "on":
        pass
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    process.stdout.close()
    folder = tmp_path / "clay_cache_take_001"
    take = read_take(folder)
    assert take.header.seconds is None
    assert take.seconds >= 2.0
    stored = store_take(studio.scene, folder)
    assert stored.last - 1 == pytest.approx(60 * take.seconds, abs=1.0)
    for frame in (1, 60, 120):
        studio.scene.frame_set(frame)
        wanted = press((frame - 1) * STEP).translation
        assert (item.matrix_world.translation - wanted).length < 1e-5
    assert {*range(1, 121)} <= {*Cache(folder).frames()}
    assert take_start(bpy.data.objects["Clay"]) is not None
