# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands in a scene: setting their bones, and invalid input."""

import numpy as np
import pytest

from tactile_clay.solver import Hand, HandRig, Scene
from tactile_clay.tests.experiments.hand_shapes import finger
from tactile_clay.tests.experiments.shapes import at


@pytest.fixture(scope="module")
def rig() -> HandRig:
    """A finger."""
    return finger(0.01)


@pytest.fixture
def hand(rig: HandRig) -> Hand:
    """The finger in a scene."""
    return Scene().add_hand(rig)


def test_other_bones_keep_their_poses(hand: Hand):
    """Move only the named bones."""
    before = hand.bones.copy()
    hand.set_bones({"bone_1": at(0.1, 0.2, 0.3)})
    np.testing.assert_array_equal(hand.bones[1], at(0.1, 0.2, 0.3))
    np.testing.assert_array_equal(hand.bones[[0, 2]], before[[0, 2]])
    hand.set_bones({})
    np.testing.assert_array_equal(hand.bones[1], at(0.1, 0.2, 0.3))


def test_all_bones_are_set_by_an_array_in_the_order_of_the_rig(hand: Hand):
    """Accept poses by index or by name, and copy the caller's array."""
    assert hand.bone_names == hand.rig.bone_names
    poses = at(0.1, 0.2, 0.3) @ hand.rig.bone_rest
    by_name = dict(zip(hand.bone_names, poses.copy(), strict=True))
    hand.set_bones(poses)
    by_index = hand.bones.copy()
    poses[:] = np.nan
    np.testing.assert_array_equal(hand.bones, by_index)
    hand.set_bones({name: np.eye(4) for name in hand.bone_names})
    hand.set_bones(by_name)
    np.testing.assert_array_equal(hand.bones, by_index)
    hand.set_bones(by_index.astype(np.float32).tolist())
    np.testing.assert_allclose(hand.bones, by_index, rtol=1e-6)


@pytest.mark.parametrize(
    ("shape", "message"),
    [((2, 4, 4), "2, 4, 4.*3 bones"), ((3, 3, 3), "3, 3, 3"), ((4, 4), "4, 4"), ((0,), "0,")],
)
def test_an_array_of_another_shape_is_refused(hand: Hand, shape: tuple[int, ...], message: str):
    """Name the expected shape, and keep the pose."""
    before = hand.bones.copy()
    with pytest.raises(ValueError, match=message):
        hand.set_bones(np.zeros(shape))
    np.testing.assert_array_equal(hand.bones, before)


def _with(row: int, column: int, value: float) -> np.ndarray:
    pose = np.eye(4)
    pose[row, column] = value
    return pose


@pytest.mark.parametrize(
    ("name", "pose", "message"),
    [
        ("thumb", np.eye(4), "no bone 'thumb'.*bone_0, bone_1"),
        ("bone_1", np.eye(3), "4x4"),
        ("bone_1", _with(0, 3, np.nan), "not finite"),
        ("bone_1", _with(2, 2, np.inf), "not finite"),
        ("bone_1", _with(0, 3, 1e9), "farther"),
        ("bone_1", _with(3, 0, 1.0), "0 0 0 1"),
        ("bone_1", _with(0, 0, -1.0), "mirrored"),
        ("bone_1", _with(0, 0, 0.0), "mirrored.*or flat"),
        ("bone_1", np.diag([9.0, 9.0, 9.0, 1.0]), "stretches"),
    ],
)
def test_invalid_bones_are_refused_and_the_last_valid_pose_is_kept(
    hand: Hand, name: str, pose: np.ndarray, message: str
):
    """Say what is wrong with a bone, and keep the poses of all bones."""
    hand.set_bones({"bone_0": at(0.0, 0.0, 0.1)})
    before = hand.bones.copy()
    with pytest.raises(ValueError, match=message):
        hand.set_bones({"bone_0": at(1.0, 0.0, 0.0), name: pose})
    np.testing.assert_array_equal(hand.bones, before)
    if name in hand.bone_names and pose.shape == (4, 4):
        poses = np.stack([at(1.0, 0.0, 0.0), pose, at(0.0, 0.0, 0.2)])
        with pytest.raises(ValueError, match=message):
            hand.set_bones(poses)
        np.testing.assert_array_equal(hand.bones, before)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("friction", -1.0),
        ("young_modulus", 0.0),
        ("young_modulus", np.nan),
        ("poisson_ratio", 0.5),
        ("poisson_ratio", -0.1),
        ("hold_stiffness", 0.0),
        ("hold_stiffness", np.inf),
    ],
)
def test_invalid_options_are_refused(rig: HandRig, option: str, value: float):
    """Name the invalid value."""
    scene = Scene()
    with pytest.raises(ValueError, match=r"friction|modulus|ratio|stiffness"):
        scene.add_hand(rig, **{option: value})
    assert scene.hands == []


def test_a_hand_can_be_lost_and_found(hand: Hand):
    """Store whether the hand is tracked."""
    assert hand.tracked
    hand.set_tracked(False)
    assert not hand.tracked
