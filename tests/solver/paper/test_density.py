# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's kernel and incompressibility."""

import numpy as np
import pytest
import warp as wp

from tactile_clay.solver import Material, Scene
from tactile_clay.solver.core.particles import Particles
from tactile_clay.solver.paper.density import DensityConstraints
from tactile_clay.solver.paper.kernel import KERNEL_RADIUS, cubic_gradient, cubic_kernel
from tactile_clay.solver.paper.neighbors import NeighborRows
from tactile_clay.tests.experiments.shapes import block

SPACING = 0.005
HEAVY, LIGHT = Material(density=4000.0), Material(density=500.0)


def particles_at(points: np.ndarray) -> tuple[Particles, NeighborRows]:
    """Particles, the first half heavy and the others light, and their neighbors."""
    scene = Scene(SPACING)
    scene.add_clay(points[: len(points) // 2], HEAVY)
    scene.add_clay(points[len(points) // 2 :], LIGHT)
    particles = Particles(scene, wp.get_device("cpu"))
    neighbors = NeighborRows(
        particles.count, SPACING, KERNEL_RADIUS * SPACING, 0.3 * SPACING, particles.device
    )
    neighbors.rebuild(particles.position)
    neighbors.begin_substep(particles.position)
    return particles, neighbors


def project(points: np.ndarray, displacement: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Displacements after one projection, and each particle's compression before it."""
    particles, neighbors = particles_at(points)
    density = DensityConstraints(particles)
    density.begin_substep(1.0)
    before = wp.array(displacement, dtype=wp.vec3)
    after = wp.zeros_like(before)
    density.project(neighbors.support, before, after)
    return after.numpy().astype(float), density.compression.numpy()


def test_kernel_sums_to_one_over_a_lattice():
    """Sum to density 1 and gradient 0 over a lattice."""
    steps = np.stack(np.meshgrid(*[np.arange(-2, 3)] * 3, indexing="ij"), -1).reshape(-1, 3)
    total = sum(cubic_kernel(float(np.linalg.norm(s)), KERNEL_RADIUS) for s in steps)
    gradient = sum(np.array(cubic_gradient(wp.vec3(*map(float, s)), KERNEL_RADIUS)) for s in steps)
    assert total == pytest.approx(1.0, abs=1e-4)
    assert np.abs(gradient).max() < 1e-6


def test_kernel_integrates_to_one():
    """Integrate to 1, as a smoothing kernel must."""
    radius = 1.7
    r = (np.arange(2000) + 0.5) * radius / 2000
    values = np.array([cubic_kernel(float(x), radius) for x in r])
    assert np.sum(4 * np.pi * r**2 * values) * radius / 2000 == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("distance", [0.2, 0.45, 0.55, 0.9])
def test_gradient_is_that_of_the_kernel(distance: float):
    """Agree with a finite difference; the gradient points to the neighbor."""
    step = 1e-3
    slope = (cubic_kernel(distance + step, 1.0) - cubic_kernel(distance - step, 1.0)) / (2 * step)
    gradient = np.array(cubic_gradient(wp.vec3(0.0, distance, 0.0), 1.0))
    assert gradient[1] == pytest.approx(-slope, rel=5e-3)
    assert gradient[0] == gradient[2] == 0.0


def test_stretched_clay_is_left_alone():
    """Resist compression only, so that surfaces do not clump."""
    points = 1.05 * block(5, SPACING)
    displacement = np.zeros_like(points)
    after, compression = project(points, displacement)
    np.testing.assert_array_equal(after, displacement)
    assert compression.max() == 0.0


def test_squeezed_clay_expands():
    """Measure the compression of a squeezed lattice, and push its surface outward."""
    points = block(7, SPACING)
    points -= points.mean(0)
    after, compression = project(0.95 * points, np.zeros_like(points))
    middle = np.linalg.norm(points, axis=1).argmin()
    assert compression[middle] == pytest.approx(1 / 0.95**3 - 1, rel=0.1)
    corner = np.linalg.norm(points, axis=1).argmax()
    assert after[corner] @ points[corner] > 0
    assert (after * points).sum() > 0


def test_projection_keeps_momentum():
    """Change neither linear nor angular momentum of particles of very different masses."""
    random = np.random.default_rng(0)
    points = 0.93 * block(5, SPACING) + random.normal(0, 0.05 * SPACING, (125, 3))
    displacement = random.normal(0, 0.02 * SPACING, points.shape)
    after, _ = project(points, displacement)
    mass = np.where(np.arange(125) < 62, HEAVY.density, LIGHT.density)[:, None] * SPACING**3
    change = mass * (after - displacement)
    scale = np.abs(change).sum()
    assert scale > 0
    assert np.abs(change.sum(0)).max() < 1e-5 * scale
    torque = np.cross(points + displacement, change).sum(0)
    assert np.abs(torque).max() < 1e-5 * scale * SPACING * 5
