# SPDX-License-Identifier: GPL-3.0-or-later
"""Keyed poses: sculpted shapes held on the timeline, and simulated shapes held on twos."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from tactile_clay.clay_addon.bake.bake import bake
from tactile_clay.clay_addon.clay import look
from tactile_clay.clay_addon.clay.make_clay import make_clay
from tactile_clay.clay_addon.deliver.delivery import deliver
from tactile_clay.clay_addon.deliver.export import export_clay
from tactile_clay.clay_addon.playback.pack import pack_bake
from tactile_clay.clay_addon.playback.packed import is_packed
from tactile_clay.clay_addon.playback.poses import (
    PoseError,
    key_pose,
    pose_at,
    pose_modifier,
    pose_times,
)
from tactile_clay.clay_addon.sculpt.live.surface import LiveSurface


def shown(clay: Any, frame: int) -> np.ndarray:
    """Positions that the object shows as points at a frame, in its own coordinates."""
    bpy.context.scene.frame_set(frame)
    geometry = clay.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    positions = np.empty((len(geometry.pointcloud.points), 3), np.float32)
    geometry.pointcloud.attributes["position"].data.foreach_get("vector", positions.ravel())
    return positions


def sculpt(clay: Any, shift: float) -> np.ndarray:
    """Move the clay's own points, as a sculpting session does, and return their positions."""
    layer = clay.data.attributes["position"].data
    positions = np.empty((len(layer), 3), np.float32)
    layer.foreach_get("vector", positions.ravel())
    positions[:, 0] += shift
    layer.foreach_set("vector", positions.ravel())
    clay.data.update_tag()
    return positions


@pytest.fixture
def clay(studio: Any) -> Any:
    """A block of clay that shows points."""
    item = studio.clay()
    look.set_input(item.modifiers["Clay Surface"], "Surface", False)
    return item


def key_two(studio: Any, clay: Any) -> tuple[np.ndarray, np.ndarray]:
    """Key a shape at frame 2 and another, with fewer particles, at frame 5."""
    studio.scene.frame_set(2)
    first = sculpt(clay, 0.01)
    assert bpy.ops.clay.pose_key() == {"FINISHED"}
    other = make_clay(bpy.context, [studio.block(size=0.02)], spacing=0.01, name="Small")
    clay.data = other.data.copy()
    bpy.data.objects.remove(other)
    studio.select(clay)
    studio.scene.frame_set(5)
    second = sculpt(clay, -0.02)
    assert bpy.ops.clay.pose_key() == {"FINISHED"}
    return first, second


READ_BACK = """
import json, os, sys
import bpy, numpy as np
path, result = sys.argv[-2:]
bpy.ops.wm.open_mainfile(filepath=path)
clay = bpy.data.objects["Clay"]
found = {"foreign": [name for name in sys.modules if name.startswith("tactile_clay")]}
for number in (1, 2, 4, 5, 9):
    bpy.context.scene.frame_set(number)
    geometry = clay.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    positions = np.empty((len(geometry.pointcloud.points), 3), np.float32)
    geometry.pointcloud.attributes["position"].data.foreach_get("vector", positions.ravel())
    found[str(number)] = positions.tolist()
with open(result, "w") as file:
    json.dump(found, file)
sys.stdout.flush()
os._exit(0)
"""


def test_poses_are_held_without_the_addon(studio: Any, clay: Any, tmp_path: Path) -> None:
    """Show shapes with different particle counts exactly in a process without the add-on."""
    first, second = key_two(studio, clay)
    assert (len(first), len(second)) == (64, 8)
    path = studio.save(tmp_path)
    (tmp_path / "read_back.py").write_text(READ_BACK)
    command = [sys.executable, *(str(tmp_path / n) for n in ("read_back.py", path.name, "out"))]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert (tmp_path / "out").exists(), done.stdout[-2000:] + done.stderr[-2000:]
    found = json.loads((tmp_path / "out").read_text())
    assert found["foreign"] == []
    for number, shape in ((1, first), (2, first), (4, first), (5, second), (9, second)):
        np.testing.assert_array_equal(np.float32(found[str(number)]), shape)


def test_keys_are_ordinary_and_can_be_moved(studio: Any, clay: Any) -> None:
    """Move a pose with its key in the Dope Sheet, and key the simulation too."""
    first, second = key_two(studio, clay)
    curves = (
        clay.animation_data.action.layers[0].strips[0].channelbag(clay.animation_data.action_slot)
    )
    (curve,) = curves.fcurves
    assert [key.interpolation for key in curve.keyframe_points] == ["CONSTANT", "CONSTANT"]
    curve.keyframe_points[1].co.x = 7
    curve.update()
    np.testing.assert_array_equal(shown(clay, 6), first)
    np.testing.assert_array_equal(shown(clay, 7), second)
    assert pose_times(clay) == [2, 7]
    studio.scene.frame_set(9)
    assert bpy.ops.clay.pose_release() == {"FINISHED"}
    sculpt(clay, 1.0)
    assert shown(clay, 9)[:, 0].min() > 0.9
    np.testing.assert_array_equal(shown(clay, 8), second)


def test_keying_again_replaces_and_removing_leaves_nothing(studio: Any, clay: Any) -> None:
    """Replace a key at the same frame, and remove all data with the last key."""
    key_two(studio, clay)
    moved = sculpt(clay, 0.5)
    bpy.ops.clay.pose_key()
    np.testing.assert_array_equal(shown(clay, 5), moved)
    assert len([item for item in bpy.data.objects if "pose" in item.name]) == 2
    studio.scene.frame_set(3)
    assert "No pose is keyed at frame 3" in studio.refused(bpy.ops.clay.pose_remove)
    for frame in (2, 5):
        studio.scene.frame_set(frame)
        assert bpy.ops.clay.pose_remove() == {"FINISHED"}
    np.testing.assert_array_equal(shown(clay, 2), moved)
    assert [modifier.name for modifier in clay.modifiers] == ["Clay Surface"]
    left = [*bpy.data.objects, *bpy.data.pointclouds, *bpy.data.node_groups]
    assert not [item.name for item in left if "pose" in item.name.lower()]


def test_pose_can_be_applied_to_the_clay(studio: Any, clay: Any) -> None:
    """Replace the clay's own points, which are sculpted, baked and exported, with a pose."""
    first, _ = key_two(studio, clay)
    studio.scene.frame_set(3)
    assert bpy.ops.clay.pose_take() == {"FINISHED"}
    np.testing.assert_array_equal(sculpt(clay, 0), first)
    assert len(clay.data.attributes["rest_position"].data) == 64
    assert shown(clay, 5).shape == (8, 3)


def test_sculpting_shows_the_clay_itself(studio: Any, clay: Any) -> None:
    """Hide keyed poses while the clay is shown live, and show them again afterwards."""
    key_two(studio, clay)
    modifier = pose_modifier(clay)
    assert modifier is not None
    live = LiveSurface(bpy.context, [clay])
    try:
        assert live._show_points()
        assert not modifier.show_viewport
    finally:
        live.close()
    assert modifier.show_viewport


def test_export_and_delivery_take_the_pose_that_is_shown(
    studio: Any, clay: Any, tmp_path: Path
) -> None:
    """Export and deliver what is displayed, each pose once."""
    key_two(studio, clay)
    for frame, count in ((4, 64), (5, 8)):
        studio.scene.frame_set(frame)
        assert export_clay(bpy.context, tmp_path / "shape.stl")["particles"] == count
    result = deliver(bpy.context, start=1, end=8, directory=tmp_path / "out")
    assert result is not None
    assert (result.shapes, result.particle_count) == (2, 8)


def test_poses_of_clay_that_moves_are_delivered_where_they_are(
    studio: Any, clay: Any, tmp_path: Path
) -> None:
    """Move a held pose with its animated object, and leave the scene's frame unchanged."""
    bpy.ops.clay.pose_key()
    for frame, place in ((1, 0.0), (3, 0.2)):
        clay.location.x = place
        clay.keyframe_insert("location", frame=frame)
    studio.scene.frame_set(2)
    result = deliver(bpy.context, start=1, end=3, directory=tmp_path / "out")
    assert result is not None
    assert result.shapes == 3
    assert studio.scene.frame_current == 2
    item = studio.scene.objects["Clay Delivery"]
    for frame, place in ((1, 0.0), (3, 0.2)):
        studio.scene.frame_set(frame)
        mesh = item.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        middle = np.mean([vertex.co.x for vertex in mesh.vertices])
        assert middle == pytest.approx(place, abs=1e-3)


def test_a_duplicate_keeps_its_own_poses(studio: Any, clay: Any) -> None:
    """Leave the original's poses alone when a copy is keyed."""
    first, second = key_two(studio, clay)
    copy = clay.copy()
    copy.data = clay.data.copy()
    copy.animation_data.action = clay.animation_data.action.copy()
    bpy.context.collection.objects.link(copy)
    key_pose(copy, second + 1, time=2)
    np.testing.assert_array_equal(shown(copy, 2), second + 1)
    np.testing.assert_array_equal(shown(clay, 2), first)


def test_bad_shapes_are_refused(studio: Any, clay: Any) -> None:
    """Refuse a mesh, a wrong number of particles, and positions that are not finite."""
    with pytest.raises(PoseError, match="is a mesh"):
        key_pose(studio.block(), np.zeros((64, 3), np.float32), time=1)
    with pytest.raises(PoseError, match="needs"):
        key_pose(clay, np.zeros((3, 3), np.float32), time=1)
    clay.data.attributes["position"].data[3].vector = (float("nan"), 0, 0)
    studio.select(clay)
    assert "1 particles" in studio.refused(bpy.ops.clay.pose_key)
    assert pose_at(clay, 1) is None


def test_shapes_are_held_on_twos(studio: Any, tmp_path: Path) -> None:
    """Show every second simulated shape for two frames, in playback and packed playback."""
    clay = studio.falling_block(tmp_path, end=5)
    look.set_input(clay.modifiers["Clay Surface"], "Surface", False)
    bake(bpy.context)
    ones = {number: shown(clay, number) for number in range(1, 6)}
    studio.scene.frame_set(4)
    studio.scene.tactile_clay.hold_frames = 2
    np.testing.assert_array_equal(shown(clay, 4), ones[3])
    held = {1: 1, 2: 1, 3: 3, 4: 3, 5: 5, 9: 5}
    for number, shape in held.items():
        np.testing.assert_array_equal(shown(clay, number), ones[shape])
    assert pack_bake(studio.scene)["bytes"] == 3 * 64 * 12
    assert is_packed(clay)
    for number, shape in held.items():
        np.testing.assert_array_equal(shown(clay, number), ones[shape])
    # Held shapes are not interpolated, even at subframes for motion blur.
    studio.scene.frame_set(4, subframe=0.75)
    geometry = clay.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    assert geometry.pointcloud.points[0].co.z == ones[3][0, 2]
    assert not np.array_equal(ones[3], ones[5])
