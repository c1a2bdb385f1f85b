# SPDX-License-Identifier: GPL-3.0-or-later
"""Joints and sides of hands by the names of bones."""

import pytest

from tactile_clay.clay_addon.core.tracking.hand.bone_names import joints_of_bones, side_of_rig
from tactile_clay.clay_addon.core.tracking.protocol.joints import JOINT_COUNT, JOINT_NAMES


def test_openxr_names_are_all_joints() -> None:
    """Recognize each of OpenXR's names, short and in full."""
    full = [f"XR_HAND_JOINT_{name.upper()}_EXT" for name in JOINT_NAMES]
    assert list(joints_of_bones(JOINT_NAMES).values()) == list(range(JOINT_COUNT))
    assert list(joints_of_bones(full).values()) == list(range(JOINT_COUNT))


@pytest.mark.parametrize(
    ("name", "joint"),
    [
        ("XR_HAND_JOINT_INDEX_PROXIMAL_EXT", 7),
        ("pinky-finger-metacarpal", 21),
        ("f_index.01.L", 7),
        ("f_middle.03.R", 14),
        ("thumb.01.L", 2),
        ("DEF-thumb.03.R", 4),
        ("hand.L", 1),
        ("mixamorig:LeftHand", 1),
        ("mixamorig:LeftHandThumb1", 2),
        ("mixamorig:RightHandPinky3", 24),
        ("mixamorig:RightHandRing4", 20),
        ("Wrist", 1),
        ("palm", 0),
        ("IndexTip", 10),
        ("thumb_intermediate", None),
        ("forearm.L", None),
        ("spine.003", None),
        ("index", None),
    ],
)
def test_bones_are_recognized_by_name(name: str, joint: int | None) -> None:
    """Recognize names of OpenXR, WebXR, Rigify and Mixamo, and no others."""
    assert joints_of_bones([name]).get(name) == joint


def test_sides_are_recognized_by_name() -> None:
    """Read the side from the rig's name or else from most of its bones' names."""
    assert side_of_rig("Armature", ["hand.L", "f_index.01.L"]) == "left"
    assert side_of_rig("Armature", ["mixamorig:RightHand"]) == "right"
    assert side_of_rig("lefthand", []) == "left"
    assert side_of_rig("r_hand", ["hand.L"]) == "right"
    assert side_of_rig("Hand", JOINT_NAMES) == ""
