# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's strain-rate constraint in a corotated frame."""

import numpy as np
import warp as wp

from tactile_clay.solver import Material, Scene
from tactile_clay.solver.core.particles import Particles
from tactile_clay.solver.paper.kernel import KERNEL_RADIUS
from tactile_clay.solver.paper.neighbors import NeighborRows
from tactile_clay.solver.paper.viscosity import ViscosityConstraints
from tactile_clay.tests.experiments.shapes import block, turned

SPACING = 0.005
HEAVY, LIGHT = Material(density=4000.0), Material(density=1000.0)
MASS = np.where(np.arange(125) < 62, HEAVY.density, LIGHT.density)[:, None] * SPACING**3


def project(points: np.ndarray, displacement: np.ndarray, sweeps: int = 1) -> np.ndarray:
    """Displacements after some projections [m]."""
    scene = Scene(SPACING)
    scene.add_clay(points[: len(points) // 2], HEAVY)
    scene.add_clay(points[len(points) // 2 :], LIGHT)
    particles = Particles(scene, wp.get_device("cpu"))
    neighbors = NeighborRows(
        particles.count, SPACING, KERNEL_RADIUS * SPACING, 0.3 * SPACING, particles.device
    )
    neighbors.rebuild(particles.position)
    neighbors.begin_substep(particles.position)
    viscosity = ViscosityConstraints(particles)
    viscosity.begin_substep(neighbors.support)
    before = wp.array(displacement, dtype=wp.vec3)
    after = wp.zeros_like(before)
    for _ in range(sweeps):
        viscosity.project(neighbors.support, before, after)
        before, after = after, before
    return before.numpy().astype(float)


def jittered_block() -> np.ndarray:
    """A block of five particles per side, jittered off the lattice [m], shape [125, 3]."""
    points = block(5, SPACING)
    return points + np.random.default_rng(0).normal(0, 0.05 * SPACING, points.shape)


def test_rigid_motion_is_not_strain():
    """Leave a block unchanged that was rotated by a third of a radian and translated."""
    points = jittered_block()
    displacement = turned(points, 0.33) - points + (0.001, -0.002, 0.003)
    after = project(points, displacement)
    assert np.abs(after - displacement).max() < 1e-5 * SPACING


def test_strain_is_seen_in_the_turned_frame():
    """Correct strain with rotation by the rotated correction of the strain alone."""
    points = jittered_block()
    strained = points * (1.02, 0.99, 1.0)
    plain = project(points, strained - points) - (strained - points)
    both = turned(strained, 0.3)
    change = project(points, both - points) - (both - points)
    expected = turned(np.vstack([plain, -plain]), 0.3)[: len(plain)]
    assert np.abs(plain).max() > 1e-3 * SPACING
    assert np.abs(change - expected).max() < 2e-3 * np.abs(plain).max()


def test_projection_keeps_momentum():
    """Change neither linear nor angular momentum of particles of different masses."""
    points = jittered_block()
    displacement = np.random.default_rng(1).normal(0, 0.05 * SPACING, points.shape)
    change = MASS * (project(points, displacement) - displacement)
    scale = np.abs(change).sum()
    assert np.abs(change.sum(0)).max() < 1e-5 * scale
    torque = np.cross(points + displacement, change).sum(0)
    assert np.abs(torque).max() < 1e-5 * scale * SPACING * 5


def test_shear_decays():
    """Reduce a block's shear, and its compression, to a third in twenty sweeps."""
    points = jittered_block()
    for gradient in (np.eye(3)[[2, 1, 0]] * [[1], [0], [0]], np.diag((0.0, 0.0, -1.0))):
        displacement = 0.02 * points @ gradient.T
        after = project(points, displacement, sweeps=20)
        sketch = np.linalg.lstsq(points - points.mean(0), after - after.mean(0), rcond=None)[0]
        left = np.linalg.norm(sketch + sketch.T) / np.linalg.norm(0.02 * (gradient + gradient.T))
        assert left < 1 / 3


def test_lone_and_flat_clay_stays_finite():
    """Leave rotating single particles, pairs and sheets unchanged."""
    for points in (block((1, 1, 1), SPACING), block((2, 1, 1), SPACING), block((4, 4, 1), SPACING)):
        displacement = turned(points, 0.05) - points
        after = project(points, displacement)
        assert np.isfinite(after).all()
        assert np.abs(after - displacement).max() < 0.01 * SPACING
