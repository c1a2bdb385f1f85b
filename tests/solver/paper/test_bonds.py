# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's distance constraints: when they form and break, and what they do."""

import numpy as np
import pytest
import warp as wp

from tactile_clay.solver import Material, Scene
from tactile_clay.solver.core.particles import Particles
from tactile_clay.solver.paper.bonds import (
    ACTIVATION_RATE,
    ACTIVATION_TIME,
    DEACTIVATION_RATE,
    DEACTIVATION_REACH,
    DEACTIVATION_TIME,
    BondConstraints,
)
from tactile_clay.solver.paper.kernel import KERNEL_RADIUS
from tactile_clay.solver.paper.neighbors import NeighborRows
from tactile_clay.tests.experiments.shapes import block

SPACING = 0.005
STEP = 1 / 480


class Clay:
    """Particles with neighbors and bonds."""

    def __init__(self, points: np.ndarray, densities: tuple[float, float] = (1700.0, 1700.0)):
        scene = Scene(SPACING)
        half = len(points) // 2
        scene.add_clay(points[:half], Material(density=densities[0]))
        scene.add_clay(points[half:], Material(density=densities[1]))
        self.particles = Particles(scene, wp.get_device("cpu"))
        self.neighbors = NeighborRows(
            len(points), SPACING, KERNEL_RADIUS * SPACING, 0.3 * SPACING, self.particles.device
        )
        self.neighbors.rebuild(self.particles.position)
        self.bonds = BondConstraints(self.particles)

    def pass_time(self, rate: float, duration: float) -> None:
        """Let the second of two particles move away at a strain rate [1/s], for a duration [s]."""
        gap = float(np.linalg.norm(np.diff(self.particles.position.numpy(), axis=0)))
        self.particles.velocity.assign(np.array([[0, 0, 0], [rate * gap, 0, 0]], np.float32))
        for _ in range(round(duration / STEP)):
            self.bonds.begin_substep(self.neighbors.rows, STEP)

    def rest_lengths(self) -> np.ndarray:
        """Rest lengths of the first particle's bonds [m]."""
        count = self.neighbors.rows.count.numpy()[0]
        lengths = self.neighbors.rows.rest_length.numpy()[0, :count]
        return lengths[lengths > 0]

    def project(self, displacement: np.ndarray, sweeps: int = 1) -> np.ndarray:
        """Displacements after some projections [m]."""
        before = wp.array(displacement, dtype=wp.vec3)
        after = wp.zeros_like(before)
        for _ in range(sweeps):
            self.bonds.project(self.neighbors.rows, before, after)
            before, after = after, before
        return before.numpy().astype(float)


def pair(distance: float = 1.0) -> Clay:
    """Two particles along x, some spacings apart, without a bond."""
    return Clay(np.array([[0.0, 0, 0], [distance * SPACING, 0, 0]]))


LONG = 4 * max(ACTIVATION_TIME, DEACTIVATION_TIME)
BETWEEN = 0.5 * (ACTIVATION_RATE + DEACTIVATION_RATE)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_state_has_hysteresis(sign: float):
    """Bond below one rate, release above another, and keep the state in between."""
    clay = pair()
    clay.pass_time(sign * BETWEEN, LONG)
    assert len(clay.rest_lengths()) == 0
    clay.pass_time(sign * 0.9 * ACTIVATION_RATE, LONG)
    assert len(clay.rest_lengths()) == 1
    clay.pass_time(sign * BETWEEN, LONG)
    assert len(clay.rest_lengths()) == 1
    clay.pass_time(sign * 1.1 * DEACTIVATION_RATE, LONG)
    assert len(clay.rest_lengths()) == 0


def test_rest_length_is_the_distance_at_activation():
    """Add no stress: hold a pair at its current distance."""
    for distance in (0.6, 1.0, 1.4):
        clay = pair(distance)
        clay.pass_time(0.0, LONG)
        assert clay.rest_lengths() == pytest.approx([distance * SPACING])


def test_brief_shock_cuts_nothing_and_brief_rest_bonds_nothing():
    """Change state only after the documented time."""
    clay = pair()
    clay.pass_time(0.0, 0.5 * ACTIVATION_TIME)
    clay.pass_time(BETWEEN, 2 * STEP)
    clay.pass_time(0.0, 0.5 * ACTIVATION_TIME)
    assert len(clay.rest_lengths()) == 0
    clay.pass_time(0.0, ACTIVATION_TIME)
    assert len(clay.rest_lengths()) == 1
    clay.pass_time(2 * DEACTIVATION_RATE, 0.5 * DEACTIVATION_TIME)
    clay.pass_time(BETWEEN, 2 * STEP)
    clay.pass_time(2 * DEACTIVATION_RATE, 0.5 * DEACTIVATION_TIME)
    assert len(clay.rest_lengths()) == 1


def test_far_pairs_do_not_bond_and_long_bonds_go():
    """Bond no farther than a lattice cell's diagonal, and release bonds two spacings long."""
    clay = pair(1.6)
    clay.pass_time(0.0, LONG)
    assert len(clay.rest_lengths()) == 0
    clay = pair()
    clay.pass_time(0.0, LONG)
    far = np.array([[0, 0, 0], [1.01 * DEACTIVATION_REACH * SPACING, 0, 0]], np.float32)
    clay.particles.position.assign(far)
    clay.pass_time(0.0, STEP)
    assert len(clay.rest_lengths()) == 0


def test_turning_does_not_cut():
    """Consider only the rate along the connecting segment."""
    clay = pair()
    clay.pass_time(0.0, LONG)
    clay.particles.velocity.assign(np.array([[0, 0, 0], [0, 1.0, 0]], np.float32))
    for _ in range(20):
        clay.bonds.begin_substep(clay.neighbors.rows, STEP)
    assert len(clay.rest_lengths()) == 1


def test_pair_is_projected_to_its_length():
    """Solve a single bond in one projection, split by mass (eq. 2)."""
    clay = Clay(np.array([[0.0, 0, 0], [SPACING, 0, 0]]), (1000.0, 3000.0))
    clay.bonds.activate_all(clay.neighbors.rows)
    after = clay.project(np.array([[0.0, 0, 0], [0.2 * SPACING, 0, 0]]))
    assert after[0] == pytest.approx([0.15 * SPACING, 0, 0], abs=1e-8)
    assert after[1] == pytest.approx([0.15 * SPACING, 0, 0], abs=1e-8)


def test_block_finds_its_shape_and_keeps_momentum():
    """Restore a perturbed block in 60 sweeps, without spurious linear or angular momentum."""
    points = block(5, SPACING)
    clay = Clay(points, (4000.0, 1000.0))
    clay.bonds.activate_all(clay.neighbors.rows)
    displacement = np.random.default_rng(0).normal(0, 0.03 * SPACING, points.shape)
    mass = np.where(np.arange(125) < 62, 4000.0, 1000.0)[:, None]
    change = mass * (clay.project(displacement) - displacement)
    scale = np.abs(change).sum()
    assert np.abs(change.sum(0)).max() < 1e-5 * scale
    torque = np.cross(points + displacement, change).sum(0)
    assert np.abs(torque).max() < 1e-5 * scale * SPACING * 5

    def misfit(moved: np.ndarray) -> float:
        left, right = np.nonzero(np.linalg.norm(points[:, None] - points[None], axis=2) < 0.0074)
        before = np.linalg.norm(points[left] - points[right], axis=1)
        after = np.linalg.norm((points + moved)[left] - (points + moved)[right], axis=1)
        return float(np.abs(after - before).mean())

    assert misfit(clay.project(displacement, 60)) < 0.03 * misfit(displacement)


@pytest.mark.parametrize("counts", [(9, 1, 1), (3, 3, 1), (1, 1, 2)])
def test_sparse_clay_converges(counts: tuple[int, int, int]):
    """Stay within the bound of Jacobi iteration for chains and sheets as well."""
    points = block(counts, SPACING)
    clay = Clay(points)
    clay.bonds.activate_all(clay.neighbors.rows)
    displacement = np.random.default_rng(2).normal(0, 0.02 * SPACING, points.shape)
    moved = points + clay.project(displacement, 400)
    assert np.linalg.norm(np.diff(moved, axis=0)[0]) == pytest.approx(SPACING, rel=2e-3)
