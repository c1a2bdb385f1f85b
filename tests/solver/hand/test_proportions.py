# SPDX-License-Identifier: GPL-3.0-or-later
"""Measuring a person's hand from one tracked frame."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile_clay.solver.hand.proportions import (
    AVERAGE,
    FINGERS,
    JOINT_NAMES,
    REFERENCE_LENGTH,
    measured_proportions,
)
from tactile_clay.solver.hand.shape import HandPose, hand_shape

ANGLE = st.floats(0.0, 80.0)
FLEXION = st.tuples(st.floats(-10.0, 10.0), ANGLE, ANGLE, ANGLE)


def tracked(
    side: str, length: float, pose: str | HandPose = "flat"
) -> tuple[np.ndarray, np.ndarray]:
    """What a perfect tracker says of the default hand."""
    shape = hand_shape(side, length=length, pose=pose)
    return np.array(list(shape.joints.values())), np.array(list(shape.radii.values()))


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


@settings(max_examples=30, deadline=None)
@given(
    st.sampled_from(["left", "right"]),
    st.floats(0.05, 0.4),
    st.tuples(FLEXION, FLEXION, FLEXION, FLEXION),
    st.tuples(*[st.floats(-1.0, 1.0)] * 4),
)
def test_any_pose_and_place_gives_the_same_hand(
    side: str, length: float, fingers: tuple, turn: tuple
) -> None:
    """Find length and proportions whatever the fingers do and wherever the hand is."""
    pose = HandPose(
        **dict(zip(FINGERS, fingers, strict=True)), thumb=(10.0, 10.0, 10.0, 20.0, 30.0)
    )
    joints, radii = tracked(side, length, pose)
    joints = joints @ rotation(np.array([1.0, *turn[:2]]), 3.0 * turn[2]).T + 5.0 * turn[3]
    found, hand = measured_proportions(joints, radii, side)
    assert found == pytest.approx(length, rel=2e-3)
    for name in FINGERS:
        np.testing.assert_allclose(
            hand.fingers[name].lengths, AVERAGE.fingers[name].lengths, rtol=3e-3
        )
        np.testing.assert_allclose(hand.fingers[name].radii, AVERAGE.fingers[name].radii, rtol=3e-3)
        np.testing.assert_allclose(
            hand.fingers[name].knuckle, AVERAGE.fingers[name].knuckle, atol=5e-4
        )
    np.testing.assert_allclose(hand.thumb.lengths, AVERAGE.thumb.lengths, rtol=3e-3)
    np.testing.assert_allclose(hand.palm_scale(), 1.0, rtol=5e-3)


def test_own_proportions_are_kept() -> None:
    """Keep a long index finger and a thick thumb, at the hand's own scale."""
    joints, radii = tracked("right", 0.20)
    index = [JOINT_NAMES.index(f"index_{part}") for part in ("intermediate", "distal", "tip")]
    joints[index] += 0.010 * np.array([-0.087, 0.996, 0.0])
    radii[JOINT_NAMES.index("thumb_distal")] *= 1.3
    length, hand = measured_proportions(joints, radii, "right")
    scale = length / REFERENCE_LENGTH
    assert length == pytest.approx(0.20, rel=1e-3)
    grown = hand.fingers["index"].lengths[0] * scale
    average = AVERAGE.fingers["index"].lengths[0] * 0.20 / REFERENCE_LENGTH
    assert grown == pytest.approx(average + 0.010, rel=0.01)
    assert hand.thumb.radii[2] == pytest.approx(1.3 * AVERAGE.thumb.radii[2], rel=1e-3)


def nan_joint(joints: np.ndarray, radii: np.ndarray) -> None:
    joints[9, 1] = np.nan


def no_radius(joints: np.ndarray, radii: np.ndarray) -> None:
    radii[1] = 0.0


def short_bone(joints: np.ndarray, radii: np.ndarray) -> None:
    # The tip keeps its distance, so that only one bone is short.
    middle = slice(JOINT_NAMES.index("ring_distal"), JOINT_NAMES.index("ring_tip") + 1)
    joints[middle] -= 0.9 * (joints[middle.start] - joints[middle.start - 1])


def all_in_one_place(joints: np.ndarray, radii: np.ndarray) -> None:
    joints[:] = 0.0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (nan_joint, "no position or no radius above zero for index_distal"),
        (no_radius, "for wrist"),
        (short_bone, "length of ring_intermediate is 2.6 mm; .* about 25.7 mm"),
        (all_in_one_place, "one place"),
    ],
)
def test_what_is_no_hand_is_refused(change: Callable, words: str) -> None:
    """Name the joint that is wrong, with its size."""
    joints, radii = tracked("right", 0.19)
    change(joints, radii)
    with pytest.raises(ValueError, match=words):
        measured_proportions(joints, radii, "right")


def test_wrong_shapes_and_sides_are_refused() -> None:
    """Say how many joints a hand has, and which sides there are."""
    joints, radii = tracked("right", 0.19)
    with pytest.raises(ValueError, match="26 joints"):
        measured_proportions(joints[:21], radii[:21], "right")
    with pytest.raises(ValueError, match='"right" or "left"'):
        measured_proportions(joints, radii, "both")
