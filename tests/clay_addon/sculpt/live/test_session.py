# SPDX-License-Identifier: GPL-3.0-or-later
"""The live session, ticked by the tests with their own clock."""

import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
import trimesh

from tactile_clay.clay_addon.bake.bake import BakeError, bake
from tactile_clay.clay_addon.clay.make_clay import make_clay
from tactile_clay.clay_addon.core.tools.edits import Edit
from tactile_clay.clay_addon.core.tools.settings import ToolMesh
from tactile_clay.clay_addon.model.clay_points import is_sculpted
from tactile_clay.clay_addon.playback import playback
from tactile_clay.clay_addon.sculpt.live.checks import SculptError
from tactile_clay.clay_addon.sculpt.live.current import current
from tactile_clay.clay_addon.sculpt.live.session import SculptSession
from tactile_clay.clay_addon.sculpt.live.surface import OBJECT_NAME


@dataclass
class Finger:
    """Replaces the mouse's tools: a ball that is moved by the test."""

    height: float = 0.1
    """Height of its center [m]."""
    enabled: bool = False
    stroking: bool = False
    mesh_key: Any = "ball"
    poses_asked: list[float] = field(default_factory=list)
    edits: list[Edit] = field(default_factory=list)

    def meshes(self) -> list[ToolMesh]:
        """One ball with a radius of 1 cm."""
        ball = trimesh.creation.icosphere(2, 0.01)
        return [ToolMesh(np.asarray(ball.vertices), np.asarray(ball.faces, np.int32))]

    def poses(self, duration: float, positions: Any) -> list[tuple[Any, bool]]:
        """The ball at its height, and whether it acts on the clay."""
        self.poses_asked.append(duration)
        pose = np.eye(4)
        pose[2, 3] = self.height
        return [(pose, self.enabled)]

    def take_edits(self) -> list[Edit]:
        """The edits requested by the test."""
        edits, self.edits = self.edits, []
        return edits


class Clock:
    """A clock that the test advances."""

    now = 100.0

    def __call__(self) -> float:
        """The time [s]."""
        return self.now


@dataclass
class Sculpting:
    """A session, its tool and its clock."""

    session: SculptSession
    finger: Finger
    clock: Clock

    def run(self, seconds: float) -> None:
        """Advance the clock tick by tick, waiting for the solver at each."""
        for _ in range(round(seconds * 60)):
            self.clock.now += 1 / 60
            self.session.wait()
            self.session.tick(bpy.context)
        self.session.wait()
        self.session.tick(bpy.context)

    def press(self, bottom: float, *, seconds: float = 0.25) -> None:
        """Press the finger down until its lowest point is at a height [m], and lift it."""
        self.finger.enabled = self.finger.stroking = True
        top, low = self.finger.height, bottom + 0.01
        for part in np.linspace(0.0, 1.0, round(seconds * 60)):
            self.finger.height = top + (low - top) * part
            self.run(1 / 60)
        for part in np.linspace(1.0, 0.0, 15):
            self.finger.height = top + (low - top) * part
            self.run(1 / 60)
        self.finger.enabled = self.finger.stroking = False
        self.run(0.05)


@pytest.fixture
def sculpting(studio: Any, tmp_path: Path) -> Iterator[Sculpting]:
    """A session with a block of clay on a table."""
    clay = studio.clay(location=(0.0, 0.0, 0.02))
    studio.table()
    studio.save(tmp_path)
    finger, clock = Finger(), Clock()
    running = SculptSession(bpy.context, tools=finger, clock=clock)
    current.session = running
    assert len(clay.data.points) == 64
    yield Sculpting(running, finger, clock)
    current.stop(bpy.context)


def top_of(studio: Any, clay: Any) -> float:
    """Height of the clay's top at its center [m]."""
    points = studio.points(clay)
    return float(points[np.linalg.norm(points[:, :2], axis=1) < 0.012, 2].max())


def test_clay_follows_the_tool_and_keeps_its_shape(studio: Any, sculpting: Sculpting) -> None:
    """Dent the clay, and make the dented shape the one that a bake starts from."""
    clay = studio.scene.objects["Clay"]
    sculpting.run(0.2)
    before = top_of(studio, clay)
    sculpting.press(0.025)
    dented = top_of(studio, clay)
    assert before - dented > 0.005
    assert is_sculpted(clay)
    kept = studio.points(clay, "rest_position")
    np.testing.assert_allclose(studio.points(clay), kept, atol=1e-4)
    sculpting.run(0.3)
    assert abs(top_of(studio, clay) - dented) < 0.002


def test_simulated_time_follows_the_clock(sculpting: Sculpting) -> None:
    """Simulate as much time as passes, and report a factor of 1."""
    sculpting.run(0.5)
    assert sculpting.session.pace.simulated == pytest.approx(0.5, abs=0.04)
    assert sculpting.session.factor == pytest.approx(1.0, abs=0.05)


def test_undo_restores_the_state_of_the_solver(studio: Any, sculpting: Sculpting) -> None:
    """Restore the exact solver state of an undo step."""
    clay = studio.scene.objects["Clay"]
    session = sculpting.session
    sculpting.run(0.2)
    sculpting.press(0.03)
    first = studio.points(clay)
    state = session.undo.state(studio.scene)
    assert state is not None
    mark = clay.data["clay_state"]
    sculpting.press(0.02)
    assert float(np.abs(studio.points(clay) - first).max()) > 0.003
    # What Blender's own Undo does to the points.
    inverse = np.linalg.inv(np.array(clay.matrix_world))
    local = first @ inverse[:3, :3].T + inverse[:3, 3]
    clay.data.attributes["position"].data.foreach_set("vector", local.astype(np.float32).ravel())
    clay.data["clay_state"] = mark
    session.undone()
    session.tick(bpy.context)
    session.wait()
    restored = session.simulation.snapshot()
    assert session.undo.state(studio.scene) is state
    np.testing.assert_array_equal(restored["position"], state["position"])
    np.testing.assert_allclose(session.positions, first, atol=1e-6)


def test_session_follows_added_and_removed_clay(studio: Any, sculpting: Sculpting) -> None:
    """Continue when clay is duplicated, renamed, hidden and deleted."""
    session = sculpting.session
    sculpting.run(0.1)
    clay = studio.scene.objects["Clay"]
    other = clay.copy()
    other.data = clay.data.copy()
    other.location.x += 0.1
    studio.scene.collection.objects.link(other)
    bpy.context.view_layer.update()
    sculpting.run(0.1)
    assert [part.count for part in session.simulation.parts] == [64, 64]
    other.name = "Another"
    sculpting.run(0.1)
    assert [part.name for part in session.simulation.parts] == ["Another", "Clay"]
    clay.hide_viewport = True
    bpy.context.view_layer.update()
    sculpting.run(0.1)
    assert [part.name for part in session.simulation.parts] == ["Another"]
    clay.hide_viewport = False
    bpy.data.objects.remove(other)
    sculpting.run(0.1)
    assert [part.name for part in session.simulation.parts] == ["Clay"]
    bpy.data.objects.remove(clay)
    with pytest.raises(SculptError, match="no clay"):
        sculpting.run(0.1)


def test_moved_clay_stays_where_it_was_moved(studio: Any, sculpting: Sculpting) -> None:
    """Continue with clay where the user moved it."""
    clay = studio.scene.objects["Clay"]
    sculpting.run(0.1)
    before = studio.points(clay)
    clay.location.x += 0.05
    bpy.context.view_layer.update()
    sculpting.run(0.2)
    np.testing.assert_allclose(studio.points(clay)[:, 0], before[:, 0] + 0.05, atol=1e-3)


def test_a_bake_no_longer_shows_over_sculpted_clay(studio: Any, sculpting: Sculpting) -> None:
    """Leave sculpted clay alone when the frame changes, until it is baked again."""
    clay = studio.scene.objects["Clay"]
    current.stop(bpy.context)
    bake(bpy.context, end=3)
    finger, clock = Finger(), Clock()
    again = Sculpting(SculptSession(bpy.context, tools=finger, clock=clock), finger, clock)
    again.run(0.1)
    again.press(0.025)
    again.session.finish(bpy.context)
    shape = studio.points(clay)
    studio.scene.frame_set(2)
    np.testing.assert_array_equal(studio.points(clay), shape)
    assert "sculpted since" in playback.message(studio.scene)
    bake(bpy.context, end=3)
    studio.scene.frame_set(1)
    assert not playback.message(studio.scene)
    np.testing.assert_allclose(studio.points(clay), shape, atol=1e-6)


def test_bake_and_session_do_not_fight_over_clay(studio: Any, sculpting: Sculpting) -> None:
    """Refuse a bake while clay is being sculpted, and keep the clay when the frame changes."""
    clay = studio.scene.objects["Clay"]
    with pytest.raises(BakeError, match="being sculpted"):
        bake(bpy.context, end=3)
    sculpting.run(0.1)
    sculpting.press(0.025)
    shape = studio.points(clay)
    studio.scene.frame_set(2)
    np.testing.assert_array_equal(studio.points(clay), shape)


def test_units_other_than_meters_are_honored(studio: Any) -> None:
    """Press as deep in a scene in centimeters as in one in meters."""
    studio.scene.unit_settings.scale_length = 0.01
    studio.scene.gravity = (0.0, 0.0, -981.0)
    clay = make_clay(bpy.context, [studio.block(size=4.0, location=(0.0, 0.0, 2.0))], spacing=1.0)
    bpy.ops.mesh.primitive_plane_add(size=100.0)
    assert bpy.ops.clay.collider_add() == {"FINISHED"}
    finger, clock = Finger(), Clock()
    work = Sculpting(SculptSession(bpy.context, tools=finger, clock=clock), finger, clock)
    work.run(0.1)
    work.press(0.025)
    work.session.finish(bpy.context)
    points = studio.points(clay)
    middle = points[np.linalg.norm(points[:, :2], axis=1) < 1.2]
    assert 2.3 < float(middle[:, 2].max()) < 2.9
    assert points[:, 2].min() > 0.3


def test_changing_the_tool_keeps_the_state_of_the_clay(studio: Any, sculpting: Sculpting) -> None:
    """Keep bonds, velocities and the rest of the clay's solver state when the tool changes."""
    sculpting.run(0.2)
    sculpting.finger.enabled = sculpting.finger.stroking = True
    sculpting.finger.height = 0.046
    sculpting.run(0.1)
    session = sculpting.session
    before = session.simulation.snapshot()
    sculpting.finger.mesh_key = "another"
    session.tick(bpy.context)
    session.wait()
    after = session.simulation.snapshot()
    np.testing.assert_array_equal(before["neighbor_rest_length"], after["neighbor_rest_length"])
    np.testing.assert_array_equal(before["velocity"], after["velocity"])
    np.testing.assert_array_equal(before["position"], after["position"])


def test_a_wheel_carries_its_clay_around(studio: Any) -> None:
    """Turn clay with a wheel in real time, faster on request, and keep the wheel's final angle."""
    bpy.ops.mesh.primitive_cylinder_add(radius=0.06, depth=0.02, location=(0.0, 0.0, -0.01))
    wheel = bpy.context.object
    assert bpy.ops.clay.collider_add() == {"FINISHED"}
    wheel.tactile_clay.wheel_speed = 30.0
    clay = studio.clay(location=(0.0, 0.0, 0.02))
    finger, clock = Finger(), Clock()
    work = Sculpting(SculptSession(bpy.context, tools=finger, clock=clock), finger, clock)

    def direction() -> float:
        far = studio.points(clay)[0]
        return float(np.arctan2(far[1], far[0]))

    first = direction()
    work.run(0.5)
    # A quarter turn, minus the slip while the clay accelerates.
    turned = np.degrees((direction() - first) % (2.0 * np.pi))
    assert 70.0 < turned < 95.0
    work.session.wheels.change_speeds(studio.scene, 30.0)
    before = direction()
    work.run(0.25)
    assert 75.0 < np.degrees((direction() - before) % (2.0 * np.pi)) < 100.0
    work.session.finish(bpy.context)
    # The wheel keeps its angle, and continues from there on the timeline.
    assert wheel.tactile_clay.wheel_speed == 60.0
    stands = np.degrees(np.arctan2(wheel.matrix_world[1][0], wheel.matrix_world[0][0])) % 360.0
    bpy.context.view_layer.update()
    again = np.degrees(np.arctan2(wheel.matrix_world[1][0], wheel.matrix_world[0][0])) % 360.0
    assert again == pytest.approx(stands, abs=1.0)


def test_finish_leaves_nothing_behind(studio: Any, sculpting: Sculpting, tmp_path: Path) -> None:
    """Leave no autosave, no paused playback and no session."""
    sculpting.run(0.1)
    sculpting.press(0.025)
    current.stop(bpy.context)
    assert current.session is None
    assert not list(tmp_path.glob("*autosave*"))
    assert playback.playback_state.pause_count == 0


def test_clay_is_added_removed_and_painted(studio: Any, sculpting: Sculpting) -> None:
    """Change the number of particles and their colors, and continue simulating."""
    clay = studio.scene.objects["Clay"]
    sculpting.run(0.1)
    blue = (0.0, 0.0, 1.0, 1.0)
    sculpting.finger.edits = [Edit("add", (0.0, 0.0, 0.06), 0.02, color=blue)]
    sculpting.run(0.2)
    added = len(clay.data.points) - 64
    # Part of the ball lies inside the block.
    assert 10 < added < 34
    assert sum(part.count for part in sculpting.session.simulation.parts) == 64 + added
    assert is_sculpted(clay) is False
    sculpting.run(0.6)
    # It gets an undo step like a stroke.
    assert is_sculpted(clay)
    sculpting.finger.edits = [
        Edit("paint", (0.0, 0.0, 0.0), 0.01, color=blue),
        Edit("remove", (0.0, 0.0, 0.06), 0.025),
    ]
    sculpting.run(0.2)
    assert len(clay.data.points) < 64 + added
    sculpting.finger.edits = [Edit("remove", (0.0, 0.0, 0.0), 1.0)]
    sculpting.run(0.1)
    # The last clay of an object is not removed.
    assert len(clay.data.points) > 0
    assert len(clay.data.attributes["rest_position"].data) == len(clay.data.points)


def test_paint_shows_on_clay_that_is_still(studio: Any, sculpting: Sculpting) -> None:
    """Request a new surface when only colors change."""
    sculpting.run(0.3)
    blue = (0.0, 0.0, 1.0, 1.0)
    sculpting.finger.edits = [Edit("paint", (0.0, 0.0, 0.03), 0.03, color=blue)]
    for _ in range(200):
        sculpting.run(1 / 60)
        shown = bpy.data.objects.get(OBJECT_NAME)
        layer = shown.data.attributes.get("Color") if shown is not None else None
        if layer is not None:
            colors = np.empty((len(layer.data), 4), np.float32)
            layer.data.foreach_get("color", colors.ravel())
            if colors[:, 2].max() > 0.9:
                return
    raise AssertionError("The paint never showed.")


def test_session_needs_clay(studio: Any) -> None:
    """Say that there is no clay, and change nothing."""
    with pytest.raises(SculptError, match="no clay"):
        SculptSession(bpy.context)
    assert playback.playback_state.pause_count == 0


def session_threads() -> set[str]:
    """Names of a session's threads that are alive."""
    own = ("clay-sculpt", "clay surface", "clay-autosave", "clay-take")
    return {each.name for each in threading.enumerate() if each.name.startswith(own)}


def threads_end() -> bool:
    """Whether all threads of a session end within 30 seconds."""
    until = time.perf_counter() + 30.0
    while session_threads() and time.perf_counter() < until:
        time.sleep(0.02)
    return not session_threads()


@pytest.mark.parametrize("context", [bpy.context, None], ids=["scene", "no-scene"])
def test_all_threads_end_even_if_the_end_fails(
    studio: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, context: Any
) -> None:
    """End solver, surface, autosave and take when a file loads, or when keeping the clay fails."""
    studio.clay(location=(0.0, 0.0, 0.02))
    studio.table()
    studio.save(tmp_path)
    studio.scene.tactile_clay.record_take = True
    finger, clock = Finger(), Clock()
    work = Sculpting(SculptSession(bpy.context, tools=finger, clock=clock), finger, clock)
    work.run(0.1)
    work.press(0.025)
    assert len({name.split("_")[0] for name in session_threads()}) == 4
    if context is None:
        work.session.finish(None)
    else:
        monkeypatch.setattr(work.session.clay, "has_moved_far", lambda: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            work.session.finish(bpy.context)
    assert threads_end(), session_threads()
    assert playback.playback_state.pause_count == 0
    work.session.finish(context)


def test_a_session_that_cannot_start_leaves_no_thread(
    studio: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """End the solver's thread if something fails after the build has begun."""
    studio.clay(location=(0.0, 0.0, 0.02))

    def fail(*_: Any) -> None:
        raise RuntimeError("no wheels")

    monkeypatch.setattr("tactile_clay.clay_addon.sculpt.live.session.LiveWheels", fail)
    with pytest.raises(RuntimeError, match="no wheels"):
        SculptSession(bpy.context)
    assert threads_end(), session_threads()
    assert playback.playback_state.pause_count == 0
