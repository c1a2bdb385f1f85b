# SPDX-License-Identifier: GPL-3.0-or-later
"""Importing recordings as keyframes."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from tactile_clay.clay_addon.core.tracking import TrackingError
from tactile_clay.clay_addon.core.tracking.protocol.joints import FINGERS, JOINT_NAMES, PARENTS
from tactile_clay.clay_addon.core.tracking.recording.recording import (
    Entry,
    Recorder,
    read_recording,
)
from tactile_clay.clay_addon.core.tracking.recording.resample import resampled_hands
from tactile_clay.clay_addon.tracking.armature import CONTACT_PROPERTY, placed, read_target
from tactile_clay.clay_addon.tracking.keyframes import import_recording
from tactile_clay.tests.clay_addon.core.tracking.hands import (
    MILLISECOND,
    flat_hand,
    frame_at,
    shown,
)
from tactile_clay.tests.clay_addon.tracking.blender_rigs import add_hand, head_positions


def waving(seconds: float = 1.0, side: str = "right") -> list[Entry]:
    """A hand that moves and rotates, with 100 frames/s."""
    entries = []
    for number in range(round(100 * seconds)):
        angle = 0.02 * number
        quaternion = (0.0, np.sin(angle), 0.0, np.cos(angle))
        x = -0.2 if side == "left" else 0.2
        joints = flat_hand(side, (x, 0.2 + 0.001 * number, 0.0), quaternion=quaternion)
        time = number * 10 * MILLISECOND
        entries.append(Entry(time, frame_at(time, number, side, joints=joints)))
    return entries


@pytest.mark.parametrize("kind", ["openxr", "parentless", "animation"])
def test_keyframes_play_what_was_recorded(studio: Any, kind: str) -> None:
    """Give the same pose and contact on every frame as live tracking at that time."""
    item = add_hand(kind=kind)
    scene = studio.scene
    scene.render.fps = 30
    entries = waving()
    target = read_target(item, "right", scene)
    done = import_recording(scene, entries, {"right": item}, start=11)
    assert (done.first, done.last, done.sides) == (11, 41, ("right",))
    times = [round(number / 30 * 1e9) for number in range(30)]
    hands = [shown(hand) for hand in resampled_hands(entries, times)["right"]]
    for number in (0, 5, 17, 29):
        scene.frame_set(11 + number)
        heads = head_positions(item)
        expected = placed(target, hands[number], None, scene)
        for name in ("wrist", "index_tip", "thumb_distal", "little_proximal"):
            assert np.allclose(heads[name], expected[name][:3, 3], atol=1e-5)
        assert item[CONTACT_PROPERTY] == pytest.approx(hands[number].contact, abs=1e-6)
    scene.frame_set(100)
    assert item[CONTACT_PROPERTY] == 0.0


READ_BACK = """
import json, os, sys
import bpy
bpy.ops.wm.open_mainfile(filepath=sys.argv[-2])
assert not [name for name in sys.modules if name.startswith("tactile_clay")]
hand = bpy.data.objects[sys.argv[-3]]
found = {}
for frame in (1, 8, 20):
    bpy.context.scene.frame_set(frame)
    found[frame] = {bone.name: list(bone.head) for bone in hand.pose.bones}
with open(sys.argv[-1], "w") as file:
    json.dump(found, file)
sys.stdout.flush()
os._exit(0)
"""


def test_keyframes_play_without_the_addon(studio: Any, tmp_path: Path) -> None:
    """Give the same poses in a process without the add-on."""
    item = add_hand()
    import_recording(studio.scene, waving(), {"right": item}, start=1)
    path = studio.save(tmp_path)
    script, output = tmp_path / "read_back.py", tmp_path / "heads.json"
    script.write_text(READ_BACK)
    command = [sys.executable, str(script), item.name, str(path), str(output)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert output.is_file(), done.stdout[-2000:] + done.stderr[-2000:]
    for frame, heads in json.loads(output.read_text()).items():
        studio.scene.frame_set(int(frame))
        for bone in item.pose.bones:
            assert np.allclose(heads[bone.name], bone.head, atol=1e-6)


def test_bone_lengths_are_constant_between_frames(studio: Any) -> None:
    """Keep the bones' lengths where Blender interpolates."""
    item = add_hand()
    import_recording(studio.scene, waving(), {"right": item}, start=1)
    seen = []
    for number in range(10):
        studio.scene.frame_set(3 + number, subframe=0.37)
        heads = head_positions(item)
        seen.append(
            [
                np.linalg.norm(heads[JOINT_NAMES[each]] - heads[JOINT_NAMES[PARENTS[each]]])
                for finger in FINGERS
                for each in finger[1:]
            ]
        )
    assert np.ptp(seen, axis=0).max() < 1e-5


def test_import_is_reproducible(studio: Any) -> None:
    """Give the same keyframes bit by bit, and keep the previous action."""
    item = add_hand()

    def values() -> list[float]:
        import_recording(studio.scene, waving(0.3), {"right": item}, start=1, name="Take")
        strip = item.animation_data.action.layers[0].strips[0]
        curves = strip.channelbag(item.animation_data.action_slot).fcurves
        return [point.co[1] for curve in curves for point in curve.keyframe_points]

    first = values()
    before = item.animation_data.action
    assert values() == first
    assert len(first) > 26 * 7 * 6
    assert before.use_fake_user
    assert before.name == "Take right"


def test_quaternions_do_not_flip_sign(studio: Any) -> None:
    """Have no change of sign between keyframes while the hand rotates several times."""
    item = add_hand()
    import_recording(studio.scene, waving(3.0), {"right": item}, start=1)
    strip = item.animation_data.action.layers[0].strips[0]
    curves = strip.channelbag(item.animation_data.action_slot).fcurves
    path = 'pose.bones["wrist"].rotation_quaternion'
    turns = np.array(
        [[p.co[1] for p in curve.keyframe_points] for curve in curves if curve.data_path == path]
    )
    assert turns.shape[0] == 4
    assert np.sum(turns[:, 1:] * turns[:, :-1], axis=0).min() > 0.9


def test_operator_imports_a_file(studio: Any, tmp_path: Path) -> None:
    """Read a file, and animate both hands from the first or the current frame."""
    recorder = Recorder(tmp_path / "take.jsonl")
    for side in ("left", "right"):
        for entry in waving(0.5, side):
            recorder.take(entry.frame, entry.time)
    recorder.close()
    hands = [add_hand("left", name="Hand.L"), add_hand("right", name="Hand.R")]
    studio.scene.frame_start = 5
    assert bpy.ops.clay.tracking_import(filepath=str(tmp_path / "take.jsonl")) == {"FINISHED"}
    for item, side in zip(hands, ("left", "right"), strict=True):
        action = item.animation_data.action
        assert action.name == f"take {side}"
        assert action.frame_range[0] == 5
    studio.scene.frame_set(50)
    path = str(tmp_path / "take.jsonl")
    bpy.ops.clay.tracking_import(filepath=path, use_current_frame=True)
    assert hands[0].animation_data.action.frame_range[0] == 50


def test_real_recording_is_imported(studio: Any, leap_recording: Path) -> None:
    """Import a LeapJS recording: finite, with constant bone lengths."""
    item = add_hand()
    entries = read_recording(leap_recording)
    done = import_recording(studio.scene, entries, {"right": item}, start=1)
    assert done.last > 24 * entries[-1].time * 1e-9
    seen = []
    for frame in range(1, done.last, 7):
        studio.scene.frame_set(frame)
        heads = head_positions(item)
        assert np.isfinite(list(heads.values())).all()
        seen.append(
            [
                np.linalg.norm(heads[JOINT_NAMES[each]] - heads[JOINT_NAMES[PARENTS[each]]])
                for finger in FINGERS
                for each in finger[1:]
            ]
        )
    assert np.ptp(seen, axis=0).max() < 1e-4


def test_recording_without_an_armature_is_refused(studio: Any, tmp_path: Path) -> None:
    """Name the recorded hand, and refuse a file that does not exist."""
    with pytest.raises(TrackingError, match=r"contains the left hand\. Choose an armature"):
        import_recording(studio.scene, waving(0.2, "left"), {"right": add_hand()}, start=1)
    missing = tmp_path / "nowhere.jsonl"
    assert "does not exist" in studio.refused(bpy.ops.clay.tracking_import, filepath=str(missing))
    empty = [Entry(0, frame_at(0, active=False))]
    with pytest.raises(TrackingError, match="no usable hand"):
        import_recording(studio.scene, empty, {"right": add_hand()}, start=1)
