# SPDX-License-Identifier: GPL-3.0-or-later
"""Deflection of bones by forces."""

import numpy as np
import pytest

from tactile_clay.solver.hand.rig import HandRig
from tactile_clay.solver.soft_hand.hold import HOLD_TIME, Hold
from tactile_clay.tests.experiments.hand_shapes import finger

STIFFNESS = 300.0


@pytest.fixture(scope="module")
def rig() -> HandRig:
    """A straight finger that points down, its tip at the origin."""
    return finger(0.009)


def at_tip(rig: HandRig, force: tuple[float, float, float]) -> np.ndarray:
    """A load on the lowest nodes [N]."""
    low = rig.nodes[:, 2] < rig.nodes[:, 2].min() + 1e-9
    load = np.zeros_like(rig.nodes)
    load[low] = np.array(force) / low.sum()
    return load


def poses_of(rig: HandRig, hold: Hold) -> tuple[np.ndarray, np.ndarray]:
    """The rest poses and rotations after deflection."""
    frames = np.tile((0.0, 0.0, 0.0, 1.0), (len(rig.bone_names), 1))
    return hold.applied(rig.bone_rest, frames)


def test_a_finger_yields_by_force_over_stiffness(rig: HandRig):
    """Deflect the tip of a straight finger by about F / k."""
    hold = Hold(rig, STIFFNESS)
    load = at_tip(rig, (0.3, 0.0, 0.0))
    poses_of(rig, hold)
    for _ in range(400):
        hold.follow(rig.nodes, load, 0.004)
    poses, _ = poses_of(rig, hold)
    named = dict(zip(rig.bone_names, poses, strict=True))
    moved = (rig.skinned_nodes(named) - rig.nodes)[load[:, 0] > 0].mean(0)
    # Joints without flesh beyond them do not contribute their share.
    assert 0.5 * 0.3 / STIFFNESS < moved[0] < 1.05 * 0.3 / STIFFNESS
    assert abs(moved[1]) < 1e-6


def test_bones_follow_with_a_delay(rig: HandRig):
    """Complete 1 − 1/e of the deflection after the hold time."""
    hold = Hold(rig, STIFFNESS)
    load = at_tip(rig, (0.0, 0.0, 0.3))
    for _ in range(1000):
        hold.follow(rig.nodes, load, HOLD_TIME / 1000)
    early = hold.shift[0, 2]
    for _ in range(9000):
        hold.follow(rig.nodes, load, HOLD_TIME / 1000)
    assert early / hold.shift[0, 2] == pytest.approx(1.0 - np.exp(-1.0), rel=0.01)


def test_the_response_predicts_deflections_under_small_loads(rig: HandRig):
    """Predict the final motion of the nodes by `follow` and `applied`."""
    hold = Hold(rig, STIFFNESS)
    poses_of(rig, hold)
    load = at_tip(rig, (0.003, 0.002, 0.001))
    predicted = hold.response(rig.nodes, load)
    for _ in range(600):
        hold.follow(rig.nodes, load, 0.004)
    poses, _ = poses_of(rig, hold)
    moved = rig.skinned_nodes(dict(zip(rig.bone_names, poses, strict=True))) - rig.nodes
    np.testing.assert_allclose(moved, predicted, atol=0.01 * np.abs(predicted).max())


def test_deflected_bones_move_their_children(rig: HandRig):
    """Keep the joints of a deflected finger connected."""
    hold = Hold(rig, STIFFNESS)
    hold.turn[0] = (0.3, 0.0, 0.0)
    hold.turn[1] = (0.0, 0.4, 0.0)
    hold.shift[0] = (0.01, 0.0, 0.0)
    poses, frames = poses_of(rig, hold)
    before = np.diff(rig.bone_rest[:, :3, 3], axis=0)
    after = np.diff(poses[:, :3, 3], axis=0)
    np.testing.assert_allclose(np.linalg.norm(after, axis=1), np.linalg.norm(before, axis=1))
    np.testing.assert_allclose(poses[0, :3, 3], rig.bone_rest[0, :3, 3] + np.array((0.01, 0, 0)))
    np.testing.assert_allclose(np.linalg.norm(frames, axis=1), 1.0)
    hold.reset()
    np.testing.assert_allclose(poses_of(rig, hold)[0], rig.bone_rest, atol=1e-12)
