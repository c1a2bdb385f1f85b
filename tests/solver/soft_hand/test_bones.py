# SPDX-License-Identifier: GPL-3.0-or-later
"""Interpolation of bones over a step."""

import numpy as np

from tactile_clay.solver.geometry.rotations import matrices_from_quaternions
from tactile_clay.solver.soft_hand.bones import BonePath
from tactile_clay.tests.experiments.shapes import at


def turn(axis: int, angle: float) -> np.ndarray:
    """A rotation about an axis through the origin, shape [4, 4]."""
    pose = np.eye(4)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    pose[first, first] = pose[second, second] = np.cos(angle)
    pose[second, first], pose[first, second] = np.sin(angle), -np.sin(angle)
    return pose


def test_path_starts_and_ends_exactly():
    """Start at the last poses and end at the next, for any rotation and stretch."""
    rest = np.array([at(0.1, 0.0, 0.0), turn(0, 0.7) @ np.diag([1.2, 1.2, 1.2, 1.0])])
    end = np.array(
        [at(0.3, 0.1, 0.0) @ turn(2, 3.1), turn(1, -1.0) @ np.diag([1.0, 1.5, 0.8, 1.0])]
    )
    path = BonePath(rest)
    path.aim(end)
    np.testing.assert_allclose(path.poses(0.0)[0], rest, atol=1e-12)
    np.testing.assert_allclose(path.poses(1.0)[0], end, atol=1e-12)


def test_bones_move_uniformly():
    """Complete half of the rotation and half of the motion at the middle of a step."""
    path = BonePath(np.array([at(0.0, 0.0, 1.0)]))
    path.aim(np.array([at(0.2, 0.0, 1.0) @ turn(2, 2.0)]))
    poses, frames = path.poses(0.5)
    np.testing.assert_allclose(poses[0], at(0.1, 0.0, 1.0) @ turn(2, 1.0), atol=1e-12)
    np.testing.assert_allclose(
        matrices_from_quaternions(frames[0]), turn(2, 1.0)[:3, :3], atol=1e-12
    )


def test_rotations_are_relative_to_rest():
    """Return a bone's rotation from its rest pose, for any rest pose."""
    rest = np.array([turn(0, 0.4) @ np.diag([2.0, 2.0, 2.0, 1.0])])
    path = BonePath(rest)
    path.aim(turn(1, 0.3) @ rest)
    poses, frames = path.poses(1.0)
    np.testing.assert_allclose(
        matrices_from_quaternions(frames[0]), turn(1, 0.3)[:3, :3], atol=1e-12
    )
    np.testing.assert_allclose(path.skinning_matrices(poses)[0], turn(1, 0.3), atol=1e-12)
