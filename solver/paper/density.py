# SPDX-License-Identifier: GPL-3.0-or-later
"""Incompressibility of the paper's clay: a constraint on each particle's density.

After Macklin and Müller, *Position Based Fluids*, ACM Transactions on Graphics 32(4), 2013, doi
10.1145/2461912.2461984, which section III-B of the paper refers to. One-sided: clay only resists
compression, so that its surface does not clump.
"""

import math

import numpy as np
import warp as wp

from ..core.particles import Particles
from .kernel import KERNEL_RADIUS, cubic_gradient, cubic_kernel
from .neighbors import Support

RELAXATION_TIME = 0.004
"""A substep Δt corrects a fraction Δt over this of a volume change, at most all of it [s]."""
MAX_COMPRESSION = 0.2
"""Largest compression that is corrected at once; more would throw particles apart."""
REGULARIZATION = 1e-3
"""Added to the denominator, relative to that of a full lattice."""


@wp.struct
class Density:
    """Parameters of all density constraints for one time step."""

    volume: float
    """Volume of a particle [m³]."""
    kernel_radius: float
    """Support of the kernel [m]."""
    fraction: float
    """Fraction of a volume change that one substep corrects."""
    regularization: float
    """Added to the denominator [1/(kg m²)]."""


@wp.kernel(enable_backward=False)
def solve_density(
    density: Density,
    support: Support,
    material: wp.array[int],
    mass: wp.array[float],
    position: wp.array[wp.vec3],
    displacement: wp.array[wp.vec3],
    compression: wp.array[float],
    multiplier: wp.array[float],
) -> None:
    """Find each particle's compression, and the multiplier of eq. 2 that would undo it."""
    i = wp.tid()
    radius = density.kernel_radius
    total = cubic_kernel(0.0, radius)
    own_gradient = wp.vec3()
    denominator = float(0.0)
    for slot in range(support.count[i]):
        j = support.index[i, slot]
        offset = position[j] - position[i] + (displacement[j] - displacement[i])
        total += cubic_kernel(wp.length(offset), radius)
        gradient = cubic_gradient(offset, radius) * density.volume
        own_gradient += gradient
        denominator += wp.length_sq(gradient) / mass[material[j]]
    denominator += wp.length_sq(own_gradient) / mass[material[i]]
    constraint = wp.max(total * density.volume - 1.0, 0.0)
    compression[i] = constraint
    multiplier[i] = (
        -density.fraction
        * wp.min(constraint, MAX_COMPRESSION)
        / (denominator + density.regularization)
    )


@wp.kernel(enable_backward=False)
def apply_density(
    density: Density,
    support: Support,
    material: wp.array[int],
    mass: wp.array[float],
    position: wp.array[wp.vec3],
    displacement: wp.array[wp.vec3],
    multiplier: wp.array[float],
    corrected: wp.array[wp.vec3],
) -> None:
    """Project particles by all density constraints they take part in (eq. 2)."""
    i = wp.tid()
    change = wp.vec3()
    for slot in range(support.count[i]):
        j = support.index[i, slot]
        both = multiplier[i] + multiplier[j]
        if both != 0.0:
            offset = position[j] - position[i] + (displacement[j] - displacement[i])
            change += cubic_gradient(offset, density.kernel_radius) * both
    corrected[i] = displacement[i] + change * (density.volume / mass[material[i]])


class DensityConstraints:
    """The density constraints of all particles.

    Args:
        particles: The particles that they act on.
    """

    def __init__(self, particles: Particles) -> None:
        self.particles = particles
        count, device = particles.count, particles.device
        self.density = Density()
        self.density.volume = particles.spacing**3
        self.density.kernel_radius = KERNEL_RADIUS * particles.spacing
        self.density.fraction = 1.0
        self.density.regularization = REGULARIZATION * lattice_denominator(
            particles.spacing, particles.min_mass
        )
        self.compression = wp.zeros(count, dtype=float, device=device)
        """Relative excess over the rest density, at least 0, as last evaluated."""
        self._multiplier = wp.zeros(count, dtype=float, device=device)

    def begin_substep(self, time_step: float) -> None:
        """Set the fraction that a substep of this length corrects."""
        self.density.fraction = min(1.0, time_step / RELAXATION_TIME)

    def project(self, support: Support, displacement: wp.array, corrected: wp.array) -> None:
        """Solve once for all densities.

        Args:
            support: Neighbors within the kernel.
            displacement: Displacements since the start of the substep [m], read.
            corrected: Displacements after the projection [m], written.
        """
        particles = self.particles
        wp.launch(
            solve_density,
            dim=particles.count,
            inputs=[
                self.density,
                support,
                particles.material,
                particles.mass,
                particles.position,
                displacement,
                self.compression,
                self._multiplier,
            ],
            device=particles.device,
        )
        wp.launch(
            apply_density,
            dim=particles.count,
            inputs=[
                self.density,
                support,
                particles.material,
                particles.mass,
                particles.position,
                displacement,
                self._multiplier,
                corrected,
            ],
            device=particles.device,
        )


def lattice_denominator(spacing: float, mass: float) -> float:
    """Σ |V ∇W|² / m around a particle of a cubic lattice [1/(kg m²)]."""
    steps = np.stack(np.meshgrid(*[np.arange(-2, 3)] * 3, indexing="ij"), -1).reshape(-1, 3)
    q = np.linalg.norm(steps, axis=1) / KERNEL_RADIUS
    slope = np.where(q <= 0.5, (2.0 - 3.0 * q) * q, np.maximum(1.0 - q, 0.0) ** 2)
    gradients = 48.0 / (math.pi * (KERNEL_RADIUS * spacing) ** 4) * slope
    return float((gradients**2).sum() * spacing**6 / mass)
