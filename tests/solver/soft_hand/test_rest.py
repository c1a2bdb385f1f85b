# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes of flesh and bone in a hand."""

import math

import numpy as np
import pytest

from tactile_clay.solver.soft_hand.rest import BONE_SHARE, bone_axes, flesh_rest
from tactile_clay.tests.experiments.hand_shapes import finger

RADIUS, LENGTH = 0.008, 0.05
VOLUME = math.pi * RADIUS**2 * (LENGTH - 2 * RADIUS) + 4 / 3 * math.pi * RADIUS**3


@pytest.mark.parametrize("edge", [0.009, 0.005])
def test_flesh_fills_the_skin_for_any_lattice(edge: float):
    """Count the volume inside the skin, and little of the lattice outside."""
    rig = finger(edge, radius=RADIUS, length=LENGTH)
    rest = flesh_rest(rig)
    corners = rig.nodes[rig.tetrahedra]
    lattice = np.linalg.det(corners[:, 1:] - corners[:, :1]).sum() / 6.0
    assert lattice > 1.5 * VOLUME
    # Volume outside the skin counts by a tenth.
    expected = VOLUME + 0.1 * (lattice - VOLUME)
    assert VOLUME < rest.volumes.sum() < 1.05 * expected


@pytest.mark.parametrize("edge", [0.009, 0.005])
def test_bone_fills_the_middle_of_a_finger(edge: float):
    """Fill the inner half of the radius, for any lattice."""
    rest = flesh_rest(finger(edge, radius=RADIUS, length=LENGTH))
    inner = BONE_SHARE * RADIUS
    bone = math.pi * inner**2 * (LENGTH - 2 * RADIUS) + 4 / 3 * math.pi * inner**3
    assert rest.bone_shares.sum() == pytest.approx(bone, rel=0.15)
    assert np.abs(rest.bone_shares - np.swapaxes(rest.bone_shares, 1, 2)).max() == 0.0


def test_gradients_reproduce_positions():
    """Give the identity as the deformation gradient at rest."""
    rig = finger(0.009)
    rest = flesh_rest(rig)
    deformation = np.einsum("tki,tkj->tij", rig.nodes[rig.tetrahedra], rest.gradients)
    np.testing.assert_allclose(deformation, np.tile(np.eye(3), (len(deformation), 1, 1)), atol=1e-9)


def test_bones_run_from_joint_to_joint():
    """Connect the heads of the bones by axes."""
    rig = finger(0.009, radius=RADIUS, length=LENGTH)
    starts, ends = bone_axes(rig)
    np.testing.assert_allclose(starts[:, 2], [LENGTH - RADIUS, LENGTH / 2])
    np.testing.assert_allclose(ends[:, 2], [LENGTH / 2, RADIUS])
