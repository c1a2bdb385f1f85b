# SPDX-License-Identifier: GPL-3.0-or-later
"""Retargeting: the tracker's pose with the rig's bone lengths."""

from pathlib import Path

import numpy as np
import pytest

from tactile_clay.clay_addon.core.tracking.hand.hand_tracker import HandTracker
from tactile_clay.clay_addon.core.tracking.hand.retarget import Z_UP, HandTarget, RetargetError
from tactile_clay.clay_addon.core.tracking.protocol.joints import (
    FINGERS,
    JOINT_COUNT,
    JOINT_NAMES,
    PARENTS,
    WRIST,
    reference_hand,
)
from tactile_clay.clay_addon.core.tracking.recording.recording import read_recording
from tactile_clay.solver.geometry.rotations import matrices_from_quaternions
from tactile_clay.tests.clay_addon.core.tracking.hands import flat_hand, rig_bones

TURN = np.array([0.3, -0.5, 0.2, 0.787])
TURN = TURN / np.linalg.norm(TURN)
SEGMENTS = ("metacarpal", "phalanx-proximal", "phalanx-intermediate", "phalanx-distal", "tip")


def webxr_name(name: str) -> str:
    """WebXR's name of a joint."""
    finger, _, segment = name.partition("_")
    if not segment:
        return name
    phalanx = segment if segment in ("metacarpal", "tip") else f"phalanx-{segment}"
    return f"{finger}-{'' if finger == 'thumb' else 'finger-'}{phalanx}"


def bone_lengths(posed: dict[str, np.ndarray], target: HandTarget) -> np.ndarray:
    """Distance of each bone's head from its parent joint's [m]."""
    name_of = {joint: name for name, joint in target.joints.items()}
    return np.array(
        [
            np.linalg.norm(posed[name][:3, 3] - posed[name_of[PARENTS[joint]]][:3, 3])
            for name, joint in target.joints.items()
            if PARENTS[joint] in name_of
        ]
    )


def test_hand_of_the_same_size_is_reproduced() -> None:
    """Place every bone at its joint with the joint's axes, converted to Z up."""
    hand = flat_hand(at=(0.1, 0.3, -0.2), quaternion=TURN)
    posed = HandTarget(rig_bones(), "right").posed(hand[:, :3], hand[:, 3:7])
    rotations = matrices_from_quaternions(hand[:, 3:7])
    for joint, name in enumerate(JOINT_NAMES):
        assert np.allclose(posed[name][:3, 3], Z_UP @ hand[joint, :3], atol=1e-6)
        assert np.allclose(posed[name][:3, :3], Z_UP @ rotations[joint], atol=1e-6)


def test_y_up_becomes_z_up() -> None:
    """Convert the tracker's Y to Blender's Z, and its Z towards the user to Blender's -Y."""
    assert (Z_UP @ [0, 1, 0]).tolist() == [0, 0, 1]
    assert (Z_UP @ [0, 0, 1]).tolist() == [0, -1, 0]


@pytest.mark.parametrize("size", [0.8, 1.25])
def test_lengths_are_the_rigs_own(size: float) -> None:
    """Keep the rig's bone lengths for a hand of another size, and align the palms."""
    target = HandTarget(rig_bones(), "right")
    rest = bone_lengths(rig_bones(), target)
    hand = flat_hand(quaternion=TURN, size=size)
    posed = target.posed(hand[:, :3], hand[:, 3:7])
    assert np.allclose(bone_lengths(posed, target), rest, atol=1e-7)
    palm = [WRIST, 7, 12, 17, 22]
    seen = np.array([Z_UP @ hand[joint, :3] for joint in palm])
    shown = np.array([posed[JOINT_NAMES[joint]][:3, 3] for joint in palm])
    assert np.allclose(seen.mean(axis=0), shown.mean(axis=0), atol=1e-6)


def test_fluctuating_bone_lengths_have_no_effect() -> None:
    """Give the same pose if the tracker's joints slide along its bones."""
    target = HandTarget(rig_bones(), "right")
    hand = flat_hand(quaternion=TURN)
    expected = target.posed(hand[:, :3], hand[:, 3:7])
    stretched = hand.copy()
    for finger in FINGERS[1:]:
        for joint in finger[2:]:
            stretched[joint, :3] += 0.5 * (hand[joint, :3] - hand[PARENTS[joint], :3])
    posed = target.posed(stretched[:, :3], stretched[:, 3:7])
    assert all(np.allclose(expected[name], posed[name], atol=1e-7) for name in expected)


def test_webxr_hand_without_palm_and_parents_is_recognized() -> None:
    """Find all joints of the generic WebXR hands, which lack the palm, in any order."""
    bones = rig_bones(name=webxr_name)
    del bones["palm"]
    names = sorted(bones)
    target = HandTarget({name: bones[name] for name in names}, "right")
    assert len(target.joints) == 25
    assert target.joints["index-finger-phalanx-proximal"] == 7
    assert target.joints["thumb-phalanx-distal"] == 4
    hand = flat_hand(quaternion=TURN)
    posed = target.posed(hand[:, :3], hand[:, 3:7])
    assert np.allclose(posed["index-finger-tip"][:3, 3], Z_UP @ hand[10, :3], atol=1e-6)


def test_rig_with_other_axes_gets_the_same_pose() -> None:
    """Derive the joints' axes from the rest pose if the bones have other axes, as in Rigify."""
    plain = HandTarget(rig_bones(), "right")
    swap = np.eye(4)
    # Y along the bone and Z out of the back of the hand, as in animation rigs.
    swap[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    other = HandTarget({name: matrix @ swap for name, matrix in rig_bones().items()}, "right")
    hand = flat_hand(quaternion=TURN)
    first = plain.posed(hand[:, :3], hand[:, 3:7])
    second = other.posed(hand[:, :3], hand[:, 3:7])
    for name in first:
        assert np.allclose(first[name][:3, 3], second[name][:3, 3], atol=2e-4)
        cosine = (np.trace((first[name] @ swap)[:3, :3].T @ second[name][:3, :3]) - 1.0) / 2.0
        assert cosine > np.cos(np.radians(1.0))


def test_invalid_joints_follow_their_parents() -> None:
    """Keep a finger rigid beyond its knuckle if its joints are not valid."""
    target = HandTarget(rig_bones(), "right")
    hand = flat_hand(quaternion=TURN)
    whole = target.posed(hand[:, :3], hand[:, 3:7])
    valid = np.ones(JOINT_COUNT, bool)
    valid[[8, 9, 10]] = False
    hand[[8, 9, 10]] = [0, 0, 0, 0, 0, 0, 1, 0]
    inferred = target.posed(hand[:, :3], hand[:, 3:7], valid)
    assert all(np.allclose(whole[name], inferred[name], atol=1e-6) for name in whole)


def test_scale_of_the_rest_pose_is_kept() -> None:
    """Keep a scaled armature's scale in its bones."""
    bones = {name: matrix @ np.diag([2.0, 2.0, 2.0, 1.0]) for name, matrix in rig_bones().items()}
    hand = flat_hand(quaternion=TURN)
    posed = HandTarget(bones, "right").posed(hand[:, :3], hand[:, 3:7])
    assert np.linalg.det(posed["index_distal"][:3, :3]) == pytest.approx(8.0)


def test_real_recordings_keep_the_rigs_lengths(leap_recording: Path) -> None:
    """Retarget recordings: finite, with constant bone lengths, fingertips near the tracked ones."""
    target = HandTarget(rig_bones(), "right")
    rest = bone_lengths(rig_bones(), target)
    tracker = HandTracker()
    distances = []
    for entry in read_recording(leap_recording):
        tracker.take(entry.frame, entry.time)
        hand = tracker.hand("right", entry.time)
        if hand is None:
            continue
        posed = target.posed(hand.positions, hand.quaternions, hand.valid)
        assert all(np.isfinite(matrix).all() for matrix in posed.values())
        assert np.allclose(bone_lengths(posed, target), rest, atol=1e-6)
        distances += [
            np.linalg.norm(
                posed[JOINT_NAMES[finger[-1]]][:3, 3] - Z_UP @ hand.positions[finger[-1]]
            )
            for finger in FINGERS
        ]
    assert len(distances) > 1000
    assert max(distances) < 0.025


def test_rig_that_is_not_a_hand_is_refused() -> None:
    """Name the missing bone and list the existing ones."""
    bones = rig_bones()
    with pytest.raises(RetargetError, match=r"no bone for the wrist.*Hips"):
        HandTarget({"Hips": np.eye(4)}, "right")
    with pytest.raises(RetargetError, match=r"no finger bones"):
        HandTarget({"wrist": bones["wrist"]}, "right")
    flat = {**bones, "index_distal": np.diag([0.0, 1.0, 1.0, 1.0])}
    with pytest.raises(RetargetError, match="'index_distal' is not finite, or its scale is zero"):
        HandTarget(flat, "right")
    tangled = {name: matrix @ np.diag([-1.0, 1.0, -1.0, 1.0]) for name, matrix in bones.items()}
    tangled["ring_distal"] = tangled["ring_intermediate"]
    with pytest.raises(RetargetError, match="same position"):
        HandTarget(tangled, "right")


def test_reference_hand_gives_the_rest_pose() -> None:
    """Leave a rig in its rest pose if the tracked hand is the reference hand."""
    reference = reference_hand("left")
    hand = flat_hand("left", (0.0, 0.0, 0.0))
    posed = HandTarget(rig_bones("left"), "left").posed(reference.positions, hand[:, 3:7])
    rest = rig_bones("left")
    assert all(np.allclose(posed[name], rest[name], atol=1e-6) for name in rest)
