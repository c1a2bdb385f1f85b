# SPDX-License-Identifier: GPL-3.0-or-later
"""Posing armatures from tracked hands, in any unit and with any rig."""

from typing import Any

import bpy
import numpy as np
import pytest

from tactile_clay.clay_addon.core.tracking import TrackingError
from tactile_clay.clay_addon.core.tracking.hand.presence import TrackedHand
from tactile_clay.clay_addon.core.tracking.hand.retarget import Z_UP
from tactile_clay.clay_addon.core.tracking.hand.skeleton import complete_hand
from tactile_clay.clay_addon.core.tracking.protocol.joints import (
    FINGERS,
    JOINT_COUNT,
    JOINT_NAMES,
    PARENTS,
)
from tactile_clay.clay_addon.tracking.armature import (
    CONTACT_PROPERTY,
    is_hand,
    placed,
    read_target,
    side_of,
    write_pose,
)
from tactile_clay.tests.clay_addon.core.tracking.hands import hand_shape
from tactile_clay.tests.clay_addon.tracking.blender_rigs import add_hand, head_positions

KINDS = ("openxr", "parentless", "animation")


def seen_hand(side: str = "right", pose: str = "pinch") -> TrackedHand:
    """A tracked hand in a pose, with the rig's bone lengths."""
    shape = hand_shape(side, pose=pose)
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    positions = np.array([turn @ shape.joints[name] for name in JOINT_NAMES])
    positions += [0.1, 0.3, -0.2]
    joints = complete_hand(positions, side).astype(np.float64)
    return TrackedHand(
        side, "live", 0.75, joints[:, :3], joints[:, 3:7], np.ones(JOINT_COUNT, np.bool_)
    )


def follow(item: Any, hand: TrackedHand, origin: Any = None) -> dict[str, np.ndarray]:
    """Pose an armature like a hand, and return the positions of its bones."""
    scene = bpy.context.scene
    target = read_target(item, hand.side, scene)
    write_pose(item, placed(target, hand, origin, scene), hand.contact)
    return head_positions(item)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("side", ["left", "right"])
def test_bones_are_where_the_joints_are(studio: Any, kind: str, side: str) -> None:
    """Place every bone at its joint, with Z up, in rigs of all kinds."""
    hand = seen_hand(side)
    heads = follow(add_hand(side, kind=kind), hand)
    for joint, name in enumerate(JOINT_NAMES):
        if name != "palm":
            assert np.allclose(heads[name], Z_UP @ hand.positions[joint], atol=1e-4), name


def test_armature_may_be_transformed(studio: Any) -> None:
    """Follow the hand with an armature that is moved, rotated and uniformly scaled."""
    item = add_hand()
    item.location, item.rotation_euler, item.scale = (1, 2, 3), (0.3, 0.5, -1.0), (1.2,) * 3
    bpy.context.view_layer.update()
    hand = seen_hand()
    heads = follow(item, hand)
    # The rig is 1.2 times as large as the hand, so only the palms coincide.
    palm = [1, 7, 12, 17, 22]
    shown = np.mean([heads[JOINT_NAMES[joint]] for joint in palm], axis=0)
    assert np.allclose(shown, Z_UP @ hand.positions[palm].mean(axis=0), atol=1e-4)
    bone = heads["index_intermediate"] - heads["index_proximal"]
    tracked = hand.positions[8] - hand.positions[7]
    assert np.linalg.norm(bone) == pytest.approx(1.2 * np.linalg.norm(tracked), rel=1e-4)


def test_units_of_the_scene_are_used(studio: Any) -> None:
    """Follow a hand in meters in a scene in centimeters."""
    studio.scene.unit_settings.scale_length = 0.01
    hand = seen_hand()
    heads = follow(add_hand(unit=0.01), hand)
    assert np.allclose(heads["ring_tip"], 100.0 * Z_UP @ hand.positions[20], atol=1e-2)


def test_tracker_may_be_moved_and_rotated(studio: Any) -> None:
    """Move and rotate the hand with the object that marks the tracker."""
    origin = bpy.data.objects.new("Tracker", None)
    studio.scene.collection.objects.link(origin)
    origin.location, origin.rotation_euler, origin.scale = (1, 0, 0), (0, 0, np.pi / 2), (7, 7, 7)
    bpy.context.view_layer.update()
    hand = seen_hand()
    heads = follow(add_hand(), hand, origin)
    x, y, z = Z_UP @ hand.positions[10]
    assert np.allclose(heads["index_tip"], [1 - y, x, z], atol=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_bone_lengths_are_constant_over_poses(studio: Any, kind: str) -> None:
    """Keep the distances between joints to 1e-6 m while the hand bends and moves."""
    item = add_hand(kind=kind)
    seen = []
    for pose in ("flat", "relaxed", "point", "pinch"):
        heads = follow(item, seen_hand(pose=pose))
        seen.append(
            [
                np.linalg.norm(heads[JOINT_NAMES[each]] - heads[JOINT_NAMES[PARENTS[each]]])
                for finger in FINGERS
                for each in finger[1:]
            ]
        )
    assert np.ptp(seen, axis=0).max() < 1e-6


def test_bones_of_the_arm_are_left_alone(studio: Any) -> None:
    """Pose only the hand."""
    item = add_hand(kind="animation")
    item.pose.bones["forearm"].rotation_mode = "XYZ"
    item.pose.bones["forearm"].rotation_euler.x = 0.4
    follow(item, seen_hand())
    assert item.pose.bones["forearm"].rotation_euler.x == pytest.approx(0.4)


def test_contact_is_stored_in_the_armature(studio: Any) -> None:
    """Store how strongly the hand touches the clay as a custom property."""
    item = add_hand()
    follow(item, seen_hand())
    assert item[CONTACT_PROPERTY] == pytest.approx(0.75)


def test_hands_are_distinguished_from_other_armatures(studio: Any) -> None:
    """Recognize a hand, and its side by name."""
    assert is_hand(add_hand(name="Hand.L"))
    assert side_of(bpy.data.objects["Hand.L"]) == "left"
    assert side_of(add_hand(name="Hand")) == ""
    bpy.ops.object.armature_add()
    assert not is_hand(bpy.context.object)


def test_armature_that_cannot_follow_is_refused(studio: Any) -> None:
    """Explain that an armature has a non-uniform scale, or is not a hand."""
    item = add_hand()
    item.scale.x = 2.0
    bpy.context.view_layer.update()
    with pytest.raises(TrackingError, match="Apply its scale"):
        read_target(item, "right", studio.scene)
    bpy.ops.object.armature_add()
    with pytest.raises(TrackingError, match=r"'Armature' cannot follow a hand: .* no bone for the"):
        read_target(bpy.context.object, "right", studio.scene)
