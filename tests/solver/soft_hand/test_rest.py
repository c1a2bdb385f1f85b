# SPDX-License-Identifier: GPL-3.0-or-later
"""How much flesh and bone a hand holds."""

import math

import numpy as np
import pytest

from tactile_clay.solver.soft_hand.rest import BONE_SHARE, bone_axes, rest_of
from tactile_clay.tests.experiments.hand_shapes import finger

RADIUS, LENGTH = 0.008, 0.05
VOLUME = math.pi * RADIUS**2 * (LENGTH - 2 * RADIUS) + 4 / 3 * math.pi * RADIUS**3


@pytest.mark.parametrize("edge", [0.009, 0.005])
def test_flesh_fills_the_skin_whatever_the_lattice(edge: float):
    """Count what lies inside the skin, little more: the lattice sticks out far."""
    rig = finger(edge, radius=RADIUS, length=LENGTH)
    rest = rest_of(rig)
    corners = rig.nodes[rig.tetrahedra]
    lattice = np.linalg.det(corners[:, 1:] - corners[:, :1]).sum() / 6.0
    assert lattice > 1.5 * VOLUME
    # What is outside counts by a tenth.
    expected = VOLUME + 0.1 * (lattice - VOLUME)
    assert VOLUME < rest.volumes.sum() < 1.05 * expected


@pytest.mark.parametrize("edge", [0.009, 0.005])
def test_bone_fills_the_middle_of_a_finger(edge: float):
    """Hold the inner half of the radius, whatever the lattice."""
    rest = rest_of(finger(edge, radius=RADIUS, length=LENGTH))
    inner = BONE_SHARE * RADIUS
    bone = math.pi * inner**2 * (LENGTH - 2 * RADIUS) + 4 / 3 * math.pi * inner**3
    assert rest.bone_shares.sum() == pytest.approx(bone, rel=0.15)
    assert np.abs(rest.bone_shares - np.swapaxes(rest.bone_shares, 1, 2)).max() == 0.0


def test_gradients_reproduce_positions():
    """Give the identity as the deformation of flesh at rest."""
    rig = finger(0.009)
    rest = rest_of(rig)
    deformation = np.einsum("tki,tkj->tij", rig.nodes[rig.tetrahedra], rest.gradients)
    np.testing.assert_allclose(deformation, np.tile(np.eye(3), (len(deformation), 1, 1)), atol=1e-9)


def test_bones_run_from_joint_to_joint():
    """Let axes join the heads of the bones."""
    rig = finger(0.009, radius=RADIUS, length=LENGTH)
    starts, ends = bone_axes(rig)
    np.testing.assert_allclose(starts[:, 2], [LENGTH - RADIUS, LENGTH / 2])
    np.testing.assert_allclose(ends[:, 2], [LENGTH / 2, RADIUS])
