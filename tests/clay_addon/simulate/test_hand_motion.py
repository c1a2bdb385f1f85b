# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands in a bake: their effect on the clay, the recorded touch, and messages about them."""

from math import radians
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from tactile_clay.clay_addon.bake.bake import BakeError, BakeProgress, BakeStaleError, bake
from tactile_clay.clay_addon.command.status import scene_status, status_text
from tactile_clay.clay_addon.core.storage.cache import Cache
from tactile_clay.clay_addon.hands.hand import hand_objects
from tactile_clay.clay_addon.model.collider import ColliderError, make_collider
from tactile_clay.clay_addon.panel import CLAY_PT_hands
from tactile_clay.clay_addon.touch import record as touch_record
from tactile_clay.clay_addon.tracking.armature import CONTACT_PROPERTY

from ..bake.test_bake import frame_bytes
from ..test_panel import drawn

LAST = 8
"""The frame at which the finger is pressed deepest."""


@pytest.fixture(scope="module")
def pressing_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Path of a shared scene, whose hand is bound only once."""
    return tmp_path_factory.mktemp("pressing") / "scene.blend"


@pytest.fixture
def hand(studio: Any, pressing_file: Path, tmp_path: Path) -> Any:
    """A right hand whose index finger presses 2 cm into a block of clay on a table."""
    if not pressing_file.exists():
        studio.clay(location=(0.0, 0.0, 0.02))
        studio.table()
        studio.scene.cursor.location = (0.036, -0.155, 0.073)
        assert bpy.ops.clay.hand_add(side="RIGHT") == {"FINISHED"}
        bone = bpy.context.object.pose.bones["index_proximal"]
        bone.rotation_mode = "XYZ"
        for frame, angle in ((1, 0.0), (LAST, -35.0)):
            bone.rotation_euler.x = radians(angle)
            bone.keyframe_insert("rotation_euler", frame=frame)
        studio.scene.frame_end = LAST
        studio.save(pressing_file.parent, pressing_file.name)
    bpy.ops.wm.open_mainfile(filepath=str(pressing_file))
    studio.save(tmp_path)
    (item,) = hand_objects(studio.scene)
    return item


def index_tip(item: Any, frame: int) -> np.ndarray:
    """World position of the tip of the index finger at a frame."""
    bpy.context.scene.frame_set(frame)
    bone = item.parent.pose.bones["index_tip"]
    return np.array((item.parent.matrix_world @ bone.matrix).translation)


def key(item: Any, path: str, values: dict[int, float]) -> None:
    """Key a property with constant interpolation."""
    owner, _, name = path.rpartition(".")
    target = item.path_resolve(owner) if owner else item
    for frame in values:
        target.keyframe_insert(name, frame=frame)
    action = item.animation_data.action
    for curve in action.layers[0].strips[0].channelbags[0].fcurves:
        if curve.data_path == path and curve.array_index == 0:
            for point, value in zip(curve.keyframe_points, values.values(), strict=True):
                point.co.y = value
                point.interpolation = "CONSTANT"
            curve.update()


def add_array(studio: Any) -> Any:
    """Add an array under the table."""
    studio.scene.cursor.location = (0.0, 0.0, -0.15)
    assert bpy.ops.clay.array_add(preset="sonicsurface") == {"FINISHED"}
    return bpy.context.object


def test_finger_dents_the_clay_and_feels_it(studio: Any, hand: Any) -> None:
    """The finger displaces clay, and focal points are recorded on its pad."""
    add_array(studio)
    result = bake(bpy.context)
    assert (result.baked, result.quarantined, result.warnings) == (LAST, 0, ())
    cache = Cache(result.directory)
    before, after = (cache.read_frame(frame).positions for frame in (1, LAST))
    tip = index_tip(hand, LAST)
    displacement = np.linalg.norm(after - before, axis=1)
    assert displacement.max() > 0.01
    # Friction holds the lowest clay on the table.
    low, high = displacement[before[:, 2] < 0.01], displacement[before[:, 2] > 0.03]
    assert np.median(low) < 0.4 * np.median(high)
    # A fingertip is at least 6 mm thick.
    assert np.linalg.norm(after - tip, axis=1).min() > 0.005
    assert np.linalg.norm(before - tip, axis=1).min() < 0.01
    assert after[:, 2].min() > 0.003

    assert cache.foci_frames() == list(range(1, LAST + 1))
    assert len(touch_record.recorded_touch(cache, 1, scale=1.0).foci.pressures) == 0
    felt = touch_record.recorded_touch(cache, LAST - 1, scale=1.0).foci
    assert len(felt.pressures) > 0
    assert 0.0 < felt.pressures.max() <= studio.scene.tactile_touch.ceiling + 1e-3
    strongest = felt.positions[np.argmax(felt.pressures)]
    assert np.linalg.norm(strongest - index_tip(hand, LAST - 1)) < 0.03


@pytest.mark.parametrize(
    ("path", "bad"),
    [
        ('pose.bones["index_intermediate"].scale', -1.0),
        ('pose.bones["index_intermediate"].location', float("nan")),
    ],
)
def test_bad_pose_is_dropped_and_the_last_good_one_held(
    studio: Any, hand: Any, tmp_path: Path, path: str, bad: float
) -> None:
    """Frames with a mirrored or invalid bone are baked, reported, and can be resumed from."""
    good = 1.0 if bad < 0.0 else 0.0
    key(hand.parent, path, {1: good, 4: bad, 6: good})
    whole = bake(bpy.context, directory=tmp_path / "whole")
    (warning,) = whole.warnings
    assert "'Right hand' was dropped at 2 frames, first at frame 4, and the last good" in warning
    assert ("mirrored" if bad < 0.0 else "not finite") in warning
    for stop in (4, 5):

        def until(report: BakeProgress, stop: int = stop) -> bool:
            return report.frame < stop

        bake(bpy.context, progress=until, resume=stop > 4)
        assert Cache(tmp_path / "clay_cache").checkpoints()[-1] == stop
    assert bake(bpy.context, resume=True).baked == LAST - 5
    assert frame_bytes(tmp_path / "clay_cache") == frame_bytes(tmp_path / "whole")


def test_bad_pose_at_the_start_is_refused(studio: Any, hand: Any) -> None:
    """A bake does not start from an impossible pose."""
    hand.parent.pose.bones["index_distal"].scale.x = -1.0
    with pytest.raises(BakeError, match="'Right hand' cannot start from its pose at frame 1: "):
        bake(bpy.context)


def test_stopped_bake_resumes_to_the_same(studio: Any, hand: Any, tmp_path: Path) -> None:
    """A resumed bake has the bytes of an uninterrupted one, and touch recorded at all frames."""
    bake(bpy.context, directory=tmp_path / "whole")
    add_array(studio)
    first = bake(bpy.context, progress=lambda report: report.frame < 6)
    assert (first.cancelled, first.baked) == (True, 6)
    assert not touch_record.replay.paused
    assert bake(bpy.context, resume=True).baked == LAST - 6
    assert frame_bytes(tmp_path / "clay_cache") == frame_bytes(tmp_path / "whole")
    assert Cache(tmp_path / "clay_cache").foci_frames() == list(range(1, LAST + 1))


def test_change_of_a_hand_makes_the_bake_stale(studio: Any, hand: Any) -> None:
    """Changes of a hand's friction, motion and mesh are reported."""
    end = 3
    bake(bpy.context, end=end)
    hand.tactile_clay.collider_friction = 0.9
    with pytest.raises(BakeStaleError, match=r"the scene has changed: hands\. Bake again"):
        bake(bpy.context, end=end, resume=True)
    hand.tactile_clay.collider_friction = 0.5
    assert bake(bpy.context, end=end, resume=True).kept == end

    bone = hand.parent.pose.bones["thumb_proximal"]
    bone.rotation_mode = "XYZ"
    bone.keyframe_insert("rotation_euler", frame=2)
    bone.rotation_euler.x = 0.1
    bone.keyframe_insert("rotation_euler", frame=3)
    with pytest.raises(BakeStaleError, match="the hands' motion changed, first at frame 3"):
        bake(bpy.context, end=end, resume=True)
    table = scene_status(bpy.context)
    assert table["hands"][0]["problem"] == ""
    assert "the hands' motion changed, first at frame 3" in table["bake"]["stale"]
    assert "hand      Right hand: right, " in status_text(table)

    hand.data.vertices[0].co.z += 0.01
    with pytest.raises(BakeError, match=r"'Right hand' no longer .* Press Make Clay Hand again"):
        bake(bpy.context, end=end)
    assert "mesh has changed" in scene_status(bpy.context)["hands"][0]["problem"]


def test_untracked_hand_touches_nothing(studio: Any, hand: Any, tmp_path: Path) -> None:
    """A hand that the tracker does not see has no effect, however its bones move."""
    hand.parent[CONTACT_PROPERTY] = 1.0
    key(hand.parent, f'["{CONTACT_PROPERTY}"]', {1: 1.0, 2: 0.0})
    lost = Cache(bake(bpy.context, directory=tmp_path / "lost").directory)
    hand.tactile_clay.role = "NONE"
    none = Cache(bake(bpy.context, directory=tmp_path / "none").directory)
    np.testing.assert_allclose(
        lost.read_frame(LAST).positions, none.read_frame(LAST).positions, atol=1e-4
    )


def test_unit_scale_is_respected(studio: Any, hand: Any, tmp_path: Path) -> None:
    """A scene in centimeters gives the same dent and touch as one in meters."""
    add_array(studio)
    meters = Cache(bake(bpy.context, directory=tmp_path / "meters").directory)
    for item in studio.scene.objects:
        if item.parent is None and item.type != "POINTCLOUD":
            item.matrix_world = Matrix.Scale(100.0, 4) @ item.matrix_world
    studio.scene.tactile_touch.array.scale = (1.0, 1.0, 1.0)
    studio.scene.unit_settings.scale_length = 0.01
    studio.scene.gravity.z = -981.0
    clay = studio.scene.objects["Clay"]
    rest = 100.0 * studio.points(clay, "rest_position")
    clay.matrix_world = Matrix()
    clay.tactile_clay.spacing = 1.0
    for name in ("rest_position", "position"):
        clay.data.attributes[name].data.foreach_set("vector", rest.ravel())
    bpy.context.view_layer.update()
    studio.select(hand)
    assert bpy.ops.clay.hand_make() == {"FINISHED"}
    centimeters = Cache(bake(bpy.context, directory=tmp_path / "centimeters").directory)
    np.testing.assert_allclose(
        centimeters.read_frame(LAST).positions,
        100.0 * meters.read_frame(LAST).positions,
        atol=0.02,
    )
    felt, known = (
        touch_record.recorded_touch(cache, LAST - 1, scale=scale).foci
        for cache, scale in ((centimeters, 0.01), (meters, 1.0))
    )
    np.testing.assert_allclose(felt.positions, known.positions, atol=1e-3)
    np.testing.assert_allclose(felt.pressures, known.pressures, rtol=0.05)


def test_hand_switched_off_ends_the_bake(studio: Any, hand: Any) -> None:
    """The hand and frame are named, the frames are kept, and touch replays again."""

    def switch_off(report: BakeProgress) -> None:
        hand.hide_viewport = report.frame == 2

    with pytest.raises(BakeError, match="At frame 3: 'Right hand' is switched off"):
        bake(bpy.context, progress=switch_off)
    assert Cache(Path(bpy.data.filepath).parent / "clay_cache").frames() == [1, 2]
    assert not touch_record.replay.paused


def test_obstacle_to_recording_touch_is_reported(studio: Any, hand: Any) -> None:
    """A scaled array, or a hand whose fingers have no names, does not prevent a bake."""
    array = add_array(studio)
    array.scale = (2.0, 2.0, 2.0)
    result = bake(bpy.context, end=2)
    (warning,) = result.warnings
    assert "No touch was recorded with the bake: 'SonicSurface' is scaled" in warning
    assert Cache(result.directory).foci_frames() == []

    array.scale = (1.0, 1.0, 1.0)
    for number, bone in enumerate(list(hand.parent.data.bones)):
        bone.name = f"part {number}"
    studio.select(hand)
    assert bpy.ops.clay.hand_make() == {"FINISHED"}
    result = bake(bpy.context, end=2)
    (warning,) = result.warnings
    assert "Touch treats all skin of 'Right hand' as equally sensitive: " in warning
    assert Cache(result.directory).foci_frames() == [1, 2]


def test_hand_has_a_role_of_its_own(studio: Any, hand: Any) -> None:
    """A hand cannot become a collider; one bound for other clay, or not bound, is reported."""
    with pytest.raises(ColliderError, match=r"'Right hand' is a clay hand.*Remove Clay Hand first"):
        make_collider(hand)
    assert hand.tactile_clay.role == "HAND"
    studio.select(hand.parent)
    assert "Right hand" in drawn(CLAY_PT_hands)
    studio.scene.objects["Clay"].tactile_clay.spacing = 0.02
    warnings = bake(bpy.context, end=2).warnings
    assert any("bound for clay with another particle spacing" in text for text in warnings)
    studio.block(location=(0.5, 0.0, 0.0))
    bpy.context.object.tactile_clay.role = "HAND"
    with pytest.raises(BakeError, match=r"'Cube\.001' is not a clay hand\. Press Make Clay Hand"):
        bake(bpy.context, end=2)
