# SPDX-License-Identifier: GPL-3.0-or-later
"""Baking, interrupting and resuming, and detection of changes to the scene."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import bpy
import numpy as np
import pytest

from tactile_clay.clay_addon.bake import operators as bake_operators
from tactile_clay.clay_addon.bake.bake import (
    BakeError,
    BakeProgress,
    BakeStaleError,
    bake,
    bake_steps,
    free,
)
from tactile_clay.clay_addon.base import activity, modal
from tactile_clay.clay_addon.base.activity import ActivityKind, clay_activity
from tactile_clay.clay_addon.core.storage.cache import Cache, CacheError, Frame
from tactile_clay.clay_addon.model.collider import make_collider


def frame_bytes(directory: Path) -> dict[str, bytes]:
    """Name and content of every frame file."""
    return {path.name: path.read_bytes() for path in sorted(directory.glob("frame_*.npz"))}


def test_block_falls_freely(studio: Any, tmp_path: Path) -> None:
    """The first frame is the rest state; then the block falls by g t²/2 down to the table."""
    clay = studio.falling_block(tmp_path, end=4)
    rest = studio.points(clay)
    result = bake(bpy.context)
    assert (result.baked, result.kept, result.particle_count) == (4, 0, 64)
    assert result.directory == tmp_path / "clay_cache"
    cache = Cache(result.directory)
    assert cache.frames() == [1, 2, 3, 4]
    np.testing.assert_array_equal(cache.read_frame(1).positions, rest)
    assert not cache.read_frame(1).velocities.any()
    fallen = rest - cache.read_frame(4).positions
    seconds = 3 / 24
    assert fallen[:, 2].max() < 0.01 + 2e-4
    np.testing.assert_allclose(fallen[:, :2], 0.0, atol=2e-4)
    middle = rest - cache.read_frame(2).positions
    # With symplectic Euler steps it falls half a substep further.
    step = 1 / 60 / 32
    expected = 0.5 * 9.81 / 24 * (1 / 24 + step)
    np.testing.assert_allclose(middle[:, 2], expected, rtol=0.02)
    assert 0.5 * 9.81 * seconds**2 > 0.01


def test_fall_follows_gravity_and_frame_rate_of_the_scene(studio: Any, tmp_path: Path) -> None:
    """Gravity may point sideways, and the frame rate may have a base."""
    clay = studio.clay()
    studio.scene.gravity = (2.0, 0.0, 0.0)
    studio.scene.render.fps = 50
    studio.scene.render.fps_base = 0.5
    rest = studio.points(clay)
    bake(bpy.context, start=10, end=20, directory=tmp_path)
    moved = Cache(tmp_path).read_frame(20).positions - rest
    np.testing.assert_allclose(moved.mean(0), (0.5 * 2.0 * 0.1**2, 0, 0), rtol=0.02, atol=1e-5)


def test_unit_scale_is_respected(studio: Any, tmp_path: Path) -> None:
    """A scene modeled in millimeters has the same motion as one in meters."""
    studio.clay()
    bake(bpy.context, start=1, end=3, directory=tmp_path / "meters")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    studio.scene.unit_settings.scale_length = 0.001
    studio.scene.gravity = (0.0, 0.0, -9810.0)
    block = studio.block(size=40.0, location=(0.0, 0.0, 30.0))
    from tactile_clay.clay_addon.clay.make_clay import make_clay

    make_clay(bpy.context, [block], spacing=10.0)
    bake(bpy.context, start=1, end=3, directory=tmp_path / "millimeters")
    meters = Cache(tmp_path / "meters").read_frame(3).positions
    millimeters = Cache(tmp_path / "millimeters").read_frame(3).positions
    np.testing.assert_allclose(millimeters, 1000.0 * meters, atol=1e-2)


def test_gravity_that_ignores_the_unit_scale_is_reported(studio: Any, tmp_path: Path) -> None:
    """A warning says that clay hardly falls if the scene, but not gravity, is in millimeters."""
    studio.clay()
    assert bake(bpy.context, start=1, end=2, directory=tmp_path).warnings == ()
    studio.scene.unit_settings.scale_length = 0.001
    (warning,) = bake(bpy.context, start=1, end=2, directory=tmp_path).warnings
    assert "only 0.0098 m/s² at the scene's unit scale of 0.001; set it to 9810" in warning
    studio.scene.gravity.z = -9810.0
    assert bake(bpy.context, start=1, end=2, directory=tmp_path).warnings == ()


def test_several_clays_keep_their_own_particles(studio: Any, tmp_path: Path) -> None:
    """All clay in a scene is baked together, ordered by name, and each object gets its part."""
    second = studio.clay("B", location=(0.2, 0.0, 0.05))
    first = studio.clay("A", location=(-0.2, 0.0, 0.05), size=0.06)
    studio.save(tmp_path)
    bake(bpy.context, end=3)
    meta = Cache(tmp_path / "clay_cache").meta()
    assert [(part.name, part.count) for part in meta.clay] == [("A", 216), ("B", 64)]
    rest = [studio.points(item, "rest_position") for item in (first, second)]
    studio.scene.frame_set(3)
    for item, before in zip((first, second), rest, strict=True):
        moved = studio.points(item) - before
        np.testing.assert_allclose(moved[:, :2], 0.0, atol=1e-3)
        assert (moved[:, 2] < -0.01).all()


def test_tool_presses_the_clay(studio: Any, tmp_path: Path) -> None:
    """An animated mesh pushes the clay in front of it."""
    clay = studio.clay(location=(0.0, 0.0, 0.02))
    studio.table()
    tool = make_collider(studio.block(size=0.04, location=(-0.06, 0.0, 0.03)))
    for frame, x in ((1, -0.06), (9, 0.02)):
        tool.location.x = x
        tool.keyframe_insert("location", frame=frame)
    studio.save(tmp_path)
    result = bake(bpy.context, end=9)
    studio.scene.frame_set(9)
    assert studio.points(clay)[:, 0].min() > 0.035
    assert result.quarantined == 0


def test_progress_is_reported_and_the_frame_restored(studio: Any, tmp_path: Path) -> None:
    """Each frame is reported with the remaining time; the current frame is restored."""
    studio.falling_block(tmp_path, end=5)
    studio.scene.frame_set(3, subframe=0.25)
    reports: list[BakeProgress] = []
    bake(bpy.context, progress=reports.append)
    assert [report.frame for report in reports] == [1, 2, 3, 4, 5]
    assert [report.done for report in reports] == [1, 2, 3, 4, 5]
    assert reports[-1].seconds_left == 0.0
    assert (studio.scene.frame_current, studio.scene.frame_subframe) == (3, 0.25)


BAKE = """
import os, signal, sys
import bpy, tactile_clay
tactile_clay.register()
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
from tactile_clay.clay_addon.bake.bake import bake
from tactile_clay.clay_addon.core.storage import cache
kill_at, moment = int(sys.argv[2]), sys.argv[3]

def die(*_):
    os.kill(os.getpid(), signal.SIGKILL)

if moment == "writing":
    real_fsync = os.fsync
    def fsync(handle, count=[0]):
        count[0] += 1
        if count[0] > 2 * kill_at:
            die()
        real_fsync(handle)
    os.fsync = fsync
if moment == "checkpoint":
    cache.Cache.write_checkpoint = die
stop = die if moment == "between" else lambda report: None
bake(bpy.context, resume=True, progress=lambda report: stop() if report.frame == kill_at else None)
sys.stdout.flush()
os._exit(0)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
def test_bake_killed_three_times_and_resumed_is_the_same(studio: Any, tmp_path: Path) -> None:
    """Every frame has the same bytes as in an uninterrupted bake."""
    studio.clay(location=(0.0, 0.0, 0.021))
    studio.table()
    tool = make_collider(studio.block(size=0.03, location=(0.0, 0.0, 0.08)))
    for frame, height in ((1, 0.08), (14, 0.04), (26, 0.08)):
        tool.location.z = height
        tool.rotation_euler.z = 0.1 * frame
        tool.keyframe_insert("location", frame=frame)
        tool.keyframe_insert("rotation_euler", frame=frame)
    studio.scene.frame_end = 26
    path = studio.save(tmp_path)
    bake(bpy.context, directory=tmp_path / "whole")
    cache = Cache(tmp_path / "clay_cache")
    have = []
    for kill_at, moment in ((7, "writing"), (11, "checkpoint"), (16, "between"), (99, "never")):
        result = subprocess.run(
            [sys.executable, "-c", BAKE, str(path), str(kill_at), moment],
            capture_output=True,
            text=True,
            check=False,
        )
        expected = 0 if moment == "never" else -signal.SIGKILL
        assert result.returncode == expected, result.stderr
        have.append(len(cache.frames()))
    assert 0 < have[0] < have[1] < have[2] < have[3] == 26
    assert frame_bytes(cache.directory) == frame_bytes(tmp_path / "whole")
    assert not list(cache.directory.glob(".clay-*"))


def test_stopped_bake_resumes_at_the_first_missing_frame(studio: Any, tmp_path: Path) -> None:
    """Only missing frames are simulated, and the frames equal those of an uninterrupted bake."""
    studio.falling_block(tmp_path, end=8)
    bake(bpy.context, directory=tmp_path / "whole")
    first = bake(bpy.context, progress=lambda report: report.frame < 5)
    assert (first.cancelled, first.baked) == (True, 5)
    reports: list[BakeProgress] = []
    second = bake(bpy.context, resume=True, progress=reports.append)
    assert (second.cancelled, second.baked, second.kept) == (False, 3, 5)
    assert [report.frame for report in reports] == [6, 7, 8]
    assert frame_bytes(tmp_path / "clay_cache") == frame_bytes(tmp_path / "whole")
    third = bake(bpy.context, resume=True)
    assert (third.baked, third.kept) == (0, 8)


def test_closing_the_generator_leaves_a_cache_to_resume(studio: Any, tmp_path: Path) -> None:
    """Closing the generator restores the current frame and writes a checkpoint."""
    studio.falling_block(tmp_path, end=8)
    steps = bake_steps(bpy.context)
    for _ in range(4):
        next(steps)
    steps.close()
    assert studio.scene.frame_current == 1
    cache = Cache(tmp_path / "clay_cache")
    assert (cache.frames(), cache.checkpoints()) == ([1, 2, 3, 4], [4])
    assert bake(bpy.context, resume=True).baked == 4


def test_truncated_frame_is_baked_again(studio: Any, tmp_path: Path) -> None:
    """Resume replaces a truncated frame in the middle of the range."""
    studio.falling_block(tmp_path, end=6)
    directory = bake(bpy.context).directory
    whole = frame_bytes(directory)
    path = Cache(directory).frame_path(3)
    path.write_bytes(path.read_bytes()[:-50])
    result = bake(bpy.context, resume=True)
    assert (result.baked, result.kept) == (1, 5)
    assert frame_bytes(directory) == whole


def test_progress_in_a_gap_ends_at_the_total(studio: Any, tmp_path: Path) -> None:
    """Frames after a gap count as done."""
    studio.falling_block(tmp_path, end=6)
    Cache(bake(bpy.context).directory).frame_path(3).unlink()
    reports: list[BakeProgress] = []
    bake(bpy.context, resume=True, progress=reports.append)
    assert [(report.frame, report.done, report.total) for report in reports] == [
        (2, 5, 6),
        (3, 6, 6),
    ]


def test_damaged_checkpoint_costs_time_only(studio: Any, tmp_path: Path) -> None:
    """If the checkpoint cannot be read, the simulation starts from the rest state."""
    studio.falling_block(tmp_path, end=6)
    bake(bpy.context, directory=tmp_path / "whole")
    directory = bake(bpy.context, progress=lambda report: report.frame < 4).directory
    (directory / "checkpoint_000004.npz").write_bytes(b"garbage")
    reports: list[BakeProgress] = []
    bake(bpy.context, resume=True, progress=reports.append)
    assert reports[0].frame == 2
    assert frame_bytes(directory) == frame_bytes(tmp_path / "whole")


def test_resume_extends_a_finished_bake(studio: Any, tmp_path: Path) -> None:
    """After the range was extended, Resume bakes only the new frames."""
    studio.falling_block(tmp_path, end=4)
    bake(bpy.context)
    studio.scene.frame_end = 6
    assert bake(bpy.context, resume=True).baked == 2
    assert Cache(tmp_path / "clay_cache").meta().end == 6


def heavier_clay(scene: Any) -> None:
    """Change the clay's density."""
    scene.objects["Clay"].tactile_clay.density = 3000.0


def moved_clay(scene: Any) -> None:
    """Move the clay."""
    scene.objects["Clay"].location.x += 0.01


def less_gravity(scene: Any) -> None:
    """Change gravity."""
    scene.gravity = (0.0, 0.0, -1.0)


def other_frame_rate(scene: Any) -> None:
    """Change the frame rate."""
    scene.render.fps = 30


def rougher_table(scene: Any) -> None:
    """Change a collider's friction."""
    scene.objects["Table"].tactile_clay.collider_friction = 0.9


def more_substeps(scene: Any) -> None:
    """Change the solver's settings."""
    scene.tactile_clay.substeps = 48


@pytest.mark.parametrize(
    ("change", "subject"),
    [
        (heavier_clay, "materials"),
        (moved_clay, "clay"),
        (less_gravity, "gravity"),
        (other_frame_rate, "frame rate"),
        (rougher_table, "colliders"),
        (more_substeps, "solver settings"),
    ],
)
def test_stale_bake_is_detected(studio: Any, tmp_path: Path, change: Any, subject: str) -> None:
    """After a change, resuming is refused, the changed subject is named, and frames are kept."""
    studio.falling_block(tmp_path, end=3)
    bake(bpy.context)
    before = frame_bytes(tmp_path / "clay_cache")
    change(studio.scene)
    with pytest.raises(BakeStaleError, match=f"the scene has changed: {subject}. Bake again"):
        bake(bpy.context, resume=True)
    assert frame_bytes(tmp_path / "clay_cache") == before
    assert bake(bpy.context).baked == 3


def test_changed_keyframes_are_detected(studio: Any, tmp_path: Path) -> None:
    """The first baked frame at which the motion of a collider has changed is named."""
    studio.clay()
    tool = make_collider(studio.block(location=(0.5, 0.0, 0.0)))
    for frame in (1, 3, 4, 6):
        tool.location.x = 0.5 + 0.1 * frame
        tool.keyframe_insert("location", frame=frame)
    # By default, a key affects the whole curve.
    for curve in tool.animation_data.action.layers[0].strips[0].channelbags[0].fcurves:
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"
    studio.scene.frame_set(1)
    studio.save(tmp_path)
    bake(bpy.context, end=6)
    tool.location.x = 2.0
    tool.keyframe_insert("location", frame=6)
    studio.scene.frame_set(1)
    with pytest.raises(BakeStaleError, match="motion changed, first at frame 5"):
        bake(bpy.context, end=6, resume=True)


def test_other_start_is_stale(studio: Any, tmp_path: Path) -> None:
    """A bake cannot be resumed with another first frame."""
    studio.falling_block(tmp_path, end=3)
    bake(bpy.context)
    with pytest.raises(BakeStaleError, match="starts at frame 1, not at 2"):
        bake(bpy.context, start=2, resume=True)


def test_unsaved_file_is_refused(studio: Any) -> None:
    """The message asks to save the .blend first."""
    studio.clay()
    with pytest.raises(BakeError, match=r"never saved.*Save the file first"):
        bake(bpy.context)
    assert "never saved" in studio.refused(bpy.ops.clay.bake)
    assert "never saved" in studio.refused(bpy.ops.clay.resume)
    assert "never saved" in studio.refused(bpy.ops.clay.free)


def test_folder_relative_to_the_working_directory_is_refused(studio: Any, tmp_path: Path) -> None:
    """The message asks for // at the start of a relative folder."""
    studio.falling_block(tmp_path)
    studio.scene.tactile_clay.cache_directory = "cache"
    with pytest.raises(BakeError, match=r"'cache' is relative to nothing\. Begin it with //"):
        bake(bpy.context)


def test_backward_range_is_refused(studio: Any, tmp_path: Path) -> None:
    """A range that ends before it starts is refused."""
    studio.falling_block(tmp_path)
    with pytest.raises(BakeError, match="ends \\(frame 1\\) before it starts \\(frame 5\\)"):
        bake(bpy.context, start=5, end=1)


def test_read_only_folder_is_refused_before_simulating(
    studio: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The solver does not start if the cache cannot be written."""
    studio.falling_block(tmp_path)
    (tmp_path / "clay_cache").write_text("a file in the way")
    monkeypatch.setattr("tactile_clay.solver.Solver", None, raising=False)
    with pytest.raises(CacheError, match="cannot be written to"):
        bake(bpy.context)


def test_missing_folder_is_created(studio: Any, tmp_path: Path) -> None:
    """The cache folder is created with its parents."""
    studio.falling_block(tmp_path, end=2)
    studio.scene.tactile_clay.cache_directory = "//deep/down/cache"
    assert bake(bpy.context).directory == tmp_path / "deep/down/cache"
    assert Cache(tmp_path / "deep/down/cache").frames() == [1, 2]


def test_full_disk_keeps_the_frames_so_far(
    studio: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full disk is reported, and the bake can be resumed once there is space."""
    studio.falling_block(tmp_path, end=5)
    bake(bpy.context, directory=tmp_path / "whole")
    real = Cache.write_frame

    def write_frame(self: Cache, frame: Frame, meta: Any) -> None:
        if frame.number == 4:
            monkeypatch.setattr(os, "fsync", full)
        real(self, frame, meta)

    def full(handle: int) -> None:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(Cache, "write_frame", write_frame)
    with pytest.raises(CacheError, match="The disk is full"):
        bake(bpy.context)
    monkeypatch.undo()
    assert Cache(tmp_path / "clay_cache").frames() == [1, 2, 3]
    assert studio.scene.frame_current == 1
    assert bake(bpy.context, resume=True).kept == 3
    assert frame_bytes(tmp_path / "clay_cache") == frame_bytes(tmp_path / "whole")


def test_interrupted_step_leaves_no_checkpoint(
    studio: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bake interrupted in the middle of a step can be resumed with the same result."""
    from tactile_clay.clay_addon.simulate.simulation import Simulation

    studio.falling_block(tmp_path, end=5)
    bake(bpy.context, directory=tmp_path / "whole")
    real = Simulation.step

    def step(self: Simulation, part: float) -> None:
        real(self, part)
        if studio.scene.frame_current == 4:
            raise KeyboardInterrupt

    monkeypatch.setattr(Simulation, "step", step)
    with pytest.raises(KeyboardInterrupt):
        bake(bpy.context)
    monkeypatch.undo()
    cache = Cache(tmp_path / "clay_cache")
    assert (cache.frames(), cache.checkpoints()) == ([1, 2, 3], [])
    assert studio.scene.frame_current == 1
    bake(bpy.context, resume=True)
    assert frame_bytes(cache.directory) == frame_bytes(tmp_path / "whole")


def test_cache_of_another_file_is_not_overwritten(studio: Any, tmp_path: Path) -> None:
    """A copy of a file with the same cache folder does not overwrite its bake."""
    studio.falling_block(tmp_path, end=2)
    bake(bpy.context)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "copy.blend"))
    with pytest.raises(BakeError, match=r"holds the bake of scene\.blend.*Choose another"):
        bake(bpy.context)
    with pytest.raises(BakeError, match=r"holds the bake of scene\.blend"):
        free(studio.scene)
    assert bake(bpy.context, replace_other=True).baked == 2
    (tmp_path / "scene.blend").unlink()
    assert bake(bpy.context).baked == 2


def test_operators_bake_resume_and_free(studio: Any, tmp_path: Path) -> None:
    """The operators work without a window."""
    clay = studio.falling_block(tmp_path, end=3)
    rest = studio.points(clay)
    assert bpy.ops.clay.bake() == {"FINISHED"}
    studio.scene.frame_end = 4
    assert bpy.ops.clay.resume() == {"FINISHED"}
    assert Cache(tmp_path / "clay_cache").frames() == [1, 2, 3, 4]
    studio.scene.frame_set(4)
    assert (studio.points(clay)[:, 2] < rest[:, 2]).all()
    assert bpy.ops.clay.free() == {"FINISHED"}
    np.testing.assert_array_equal(studio.points(clay), rest)
    assert not (tmp_path / "clay_cache").exists()
    assert clay_activity.kind is None


class Window:
    """A mock window that runs a bake operator."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.reports: list[str] = []
        self.context: Any = SimpleNamespace(
            scene=bpy.context.scene,
            preferences=bpy.context.preferences,
            evaluated_depsgraph_get=bpy.context.evaluated_depsgraph_get,
            window=object(),
            window_manager=MagicMock(windows=[]),
            workspace=MagicMock(),
        )
        app = SimpleNamespace(background=False)
        monkeypatch.setattr(modal, "bpy", SimpleNamespace(app=app))
        operator = type("Operator", (bake_operators._BakeOperator,), {})
        self.operator = operator()
        self.operator.report = lambda kind, text: self.reports.append(text)

    def press(self, kind: str) -> set[str]:
        """Send an event to the operator."""
        return self.operator.modal(self.context, SimpleNamespace(type=kind, value="PRESS"))


def test_escape_on_a_full_disk_ends_the_bake(
    studio: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full disk is reported when the bake is stopped, and another bake can start."""
    studio.falling_block(tmp_path)
    window = Window(monkeypatch)
    assert window.operator.invoke(window.context, None) == {"RUNNING_MODAL"}
    assert window.press("TIMER") == window.press("TIMER") == {"RUNNING_MODAL"}

    def full(handle: int) -> None:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(os, "fsync", full)
    assert window.press("ESC") == {"CANCELLED"}
    assert len(window.reports) == 1
    assert "The disk is full" in window.reports[0]
    assert clay_activity.kind is None
    assert studio.scene.frame_current == 1


def test_second_bake_in_the_interface_is_refused(
    studio: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second bake is refused while one is running, which continues."""
    studio.falling_block(tmp_path)
    window = Window(monkeypatch)
    assert window.operator.invoke(window.context, None) == {"RUNNING_MODAL"}
    other = Window(monkeypatch)
    assert other.operator.invoke(other.context, None) == {"CANCELLED"}
    assert other.reports == ["A bake is running. Press Esc to stop it first."]
    assert window.press("TIMER") == {"RUNNING_MODAL"}
    assert window.press("ESC") == {"CANCELLED"}
    assert window.reports == ["Stopped. The frames so far are kept; Resume continues."]
    assert Cache(tmp_path / "clay_cache").frames() == [1, 2]


@pytest.mark.parametrize("how", ["delete", "undo"])
def test_deletion_and_undo_end_a_running_bake(studio: Any, tmp_path: Path, how: str) -> None:
    """The message says what happened, and the bake can be resumed from the frames so far."""
    studio.falling_block(tmp_path, end=4)
    bpy.ops.ed.undo_push(message="table")
    studio.table().name = "Other"
    bpy.ops.ed.undo_push(message="other table")
    steps = bake_steps(bpy.context)
    assert [next(steps).frame, next(steps).frame] == [1, 2]
    if how == "delete":
        bpy.data.objects.remove(studio.scene.objects["Other"])
    else:
        bpy.ops.ed.undo()
        bpy.ops.ed.redo()
    with pytest.raises(BakeError, match=r"was deleted, or replaced by Undo.*Resume continues"):
        next(steps)
    assert Cache(tmp_path / "clay_cache").frames() == [1, 2]
    if how == "undo":
        assert bake(bpy.context, resume=True).kept == 2


def test_add_on_disabled_during_a_bake_bakes_again(studio: Any, tmp_path: Path) -> None:
    """A bake that ended because the add-on was disabled does not block the next one."""
    studio.falling_block(tmp_path, end=2)
    clay_activity.begin(ActivityKind.BAKE)
    activity.unregister()
    activity.register()
    assert bpy.ops.clay.bake() == {"FINISHED"}
