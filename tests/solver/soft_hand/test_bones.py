# SPDX-License-Identifier: GPL-3.0-or-later
"""The way of bones through a step."""

import numpy as np

from tactile_clay.solver.geometry.rotations import matrices_from_quaternions
from tactile_clay.solver.soft_hand.bones import BonePath
from tactile_clay.tests.experiments.shapes import at


def turn(axis: int, angle: float) -> np.ndarray:
    """A pose turned about an axis through the origin."""
    pose = np.eye(4)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    pose[first, first] = pose[second, second] = np.cos(angle)
    pose[second, first], pose[first, second] = np.sin(angle), -np.sin(angle)
    return pose


def test_bones_start_and_arrive_exactly():
    """Begin at the last poses and end at the next, however they are turned and stretched."""
    rest = np.array([at(0.1, 0.0, 0.0), turn(0, 0.7) @ np.diag([1.2, 1.2, 1.2, 1.0])])
    end = np.array(
        [at(0.3, 0.1, 0.0) @ turn(2, 3.1), turn(1, -1.0) @ np.diag([1.0, 1.5, 0.8, 1.0])]
    )
    path = BonePath(rest)
    path.aim(end)
    np.testing.assert_allclose(path.poses(0.0)[0], rest, atol=1e-12)
    np.testing.assert_allclose(path.poses(1.0)[0], end, atol=1e-12)


def test_bones_turn_evenly():
    """Be half turned and halfway there in the middle of a step."""
    path = BonePath(np.array([at(0.0, 0.0, 1.0)]))
    path.aim(np.array([at(0.2, 0.0, 1.0) @ turn(2, 2.0)]))
    poses, frames = path.poses(0.5)
    np.testing.assert_allclose(poses[0], at(0.1, 0.0, 1.0) @ turn(2, 1.0), atol=1e-12)
    np.testing.assert_allclose(
        matrices_from_quaternions(frames[0]), turn(2, 1.0)[:3, :3], atol=1e-12
    )


def test_frames_are_counted_from_rest():
    """Say how a bone is turned from its rest pose, which may be any."""
    rest = np.array([turn(0, 0.4) @ np.diag([2.0, 2.0, 2.0, 1.0])])
    path = BonePath(rest)
    path.aim(turn(1, 0.3) @ rest)
    poses, frames = path.poses(1.0)
    np.testing.assert_allclose(
        matrices_from_quaternions(frames[0]), turn(1, 0.3)[:3, :3], atol=1e-12
    )
    np.testing.assert_allclose(path.turns(poses)[0], turn(1, 0.3), atol=1e-12)
