# SPDX-License-Identifier: GPL-3.0-or-later
"""Completing hands from joint positions alone."""

from itertools import pairwise

import numpy as np
import pytest

from tactile_clay.clay_addon.core.tracking.hand.skeleton import SkeletonError, complete_hand
from tactile_clay.clay_addon.core.tracking.protocol.joints import (
    FINGERS,
    JOINT_COUNT,
    JOINT_NAMES,
    KNUCKLES,
    PALM,
    WRIST,
    reference_hand,
)
from tactile_clay.solver.geometry.rotations import angles_between, matrices_from_quaternions
from tactile_clay.tests.clay_addon.core.tracking.hands import POSES, flat_hand, hand_shape

TURN = np.array([0.3, -0.5, 0.2, 0.787])
TURN = TURN / np.linalg.norm(TURN)
METACARPALS = [finger[0] for finger in FINGERS[1:]]


def posed_hand(side: str, pose: str) -> tuple[np.ndarray, np.ndarray]:
    """Positions [26, 3] and axes [26, 3, 3] of the default hand in a pose, with OpenXR's axes."""
    shape = hand_shape(side, pose=pose)
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    positions = np.array([turn @ shape.joints[name] for name in JOINT_NAMES])
    axes = np.array([turn @ shape.axes[name] @ turn.T for name in JOINT_NAMES])
    return positions, axes


def without(positions: np.ndarray, *joints: int) -> np.ndarray:
    """Positions with these joints unknown."""
    positions = positions.astype(np.float64)
    positions[list(joints)] = np.nan
    return positions


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("size", [0.7, 1.0, 1.3])
def test_missing_joints_are_reconstructed(side: str, size: float) -> None:
    """Find palm, wrist and metacarpals of a rotated hand of another size to the micrometer."""
    whole = flat_hand(side, (0.1, 0.3, -0.2), quaternion=TURN, size=size)
    found = complete_hand(without(whole[:, :3], PALM, WRIST, *METACARPALS), side)
    assert np.allclose(found[:, :3], whole[:, :3], atol=1e-6)
    assert np.degrees(angles_between(found[:, 3:7], whole[:, 3:7])).max() < 0.1
    assert np.allclose(found[:, 7], whole[:, 7], rtol=1e-5)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("pose", list(POSES))
def test_axes_of_a_posed_hand_are_reconstructed(side: str, pose: str) -> None:
    """Point -Z along each bone exactly, and Y roughly out of the finger's back."""
    positions, axes = posed_hand(side, pose)
    found = complete_hand(without(positions, PALM, *METACARPALS), side)
    rotations = matrices_from_quaternions(found[:, 3:7])
    for finger in FINGERS:
        for joint, following in pairwise(finger):
            bone = positions[following] - positions[joint]
            bone /= np.linalg.norm(bone)
            # In float32, directions are accurate to some hundredths of a degree.
            assert -rotations[joint][:, 2] @ bone > 1.0 - 1e-6
        for joint in finger[-4:]:
            cosine = float(rotations[joint][:, 1] @ axes[joint][:, 1])
            # Only the plane in which a thumb bends reveals its roll.
            assert cosine > np.cos(np.radians(20.0 if finger is FINGERS[0] else 15.0))


def test_joints_of_a_bent_finger_share_an_axis() -> None:
    """Give the joints of a curled finger a common X axis."""
    positions, _ = posed_hand("right", "point")
    rotations = matrices_from_quaternions(complete_hand(positions, "right")[:, 3:7])
    for finger in FINGERS[2:]:
        _, first, second, third, _ = finger
        assert rotations[first][:, 0] @ rotations[second][:, 0] > 0.999
        assert rotations[second][:, 0] @ rotations[third][:, 0] > 0.999


def test_given_radii_and_palm_are_kept() -> None:
    """Use the tracker's radii and palm if it gives them."""
    whole = flat_hand()
    radii = np.full(JOINT_COUNT, np.nan)
    radii[7] = 0.02
    tilted = matrices_from_quaternions([np.sin(0.1), 0.0, 0.0, np.cos(0.1)])
    found = complete_hand(whole[:, :3], "right", palm_rotation=tilted, radii=radii)
    assert found[7, 7] == pytest.approx(0.02)
    assert found[8, 7] == pytest.approx(reference_hand("right").radii[8], rel=1e-3)
    assert np.allclose(matrices_from_quaternions(found[WRIST, 3:7]), tilted, atol=1e-6)


@pytest.mark.parametrize(
    ("corrupt", "reason"),
    [
        (lambda points: points.__setitem__(8, np.nan), "missing"),
        (lambda points: points.__setitem__(8, points[7]), "same position"),
        (lambda points: points.__setitem__(slice(None), 0.0), "size of the palm"),
        (lambda points: points.__imul__(0.1), "size of the palm"),
        (lambda points: points.__setitem__(8, 1e9), "too far away"),
        (lambda points: points.__setitem__(8, 1.5), "far from each other"),
        (
            lambda points: points.__setitem__([*KNUCKLES, WRIST, 2], points[7]),
            "size of the palm|same position",
        ),
    ],
)
def test_points_that_are_not_a_hand_are_refused(corrupt, reason) -> None:
    """Refuse missing, coinciding and distant points."""
    points = flat_hand()[:, :3].astype(np.float64)
    corrupt(points)
    with pytest.raises(SkeletonError, match=reason):
        complete_hand(points, "right")
