# SPDX-License-Identifier: GPL-3.0-or-later
"""Preconditioned conjugate gradients for a Newton step of the pair forces and contacts."""

from typing import Any

import warp as wp

from .bond_law import Clay
from .coarse_space import CoarseSpace, prolong
from .pairs import Pairs

# Places in the array of scalars.
_RESIDUAL = 0
_CURVATURE = 1
_RESIDUAL_NEXT = 2


@wp.kernel(enable_backward=False)
def invert_diagonal(block: wp.array[wp.mat33], inverse: wp.array[wp.mat33]) -> None:
    """Invert each particle's own block."""
    i = wp.tid()
    inverse[i] = wp.inverse(block[i])


@wp.kernel(enable_backward=False)
def start(
    inverse: wp.array[wp.mat33],
    residual: wp.array[wp.vec3],
    z: wp.array[wp.vec3],
    change: wp.array[wp.vec3],
) -> None:
    """Begin from no change."""
    i = wp.tid()
    z[i] = inverse[i] * residual[i]
    change[i] = wp.vec3()


@wp.kernel(enable_backward=False)
def finish_z(
    cell: wp.array[int],
    center: wp.array[wp.vec3],
    modes: wp.array[float],
    position: wp.array[wp.vec3],
    residual: wp.array[wp.vec3],
    z: wp.array[wp.vec3],
    scalars: wp.array[wp.float64],
    where: int,
) -> None:
    """Add the coarse part to the preconditioned residual, and sum its square."""
    i = wp.tid()
    full = z[i] + prolong(cell[i], position[i] - center[cell[i]], modes)
    z[i] = full
    wp.atomic_add(scalars, where, wp.float64(wp.dot(full, residual[i])))


@wp.kernel(enable_backward=False)
def turn_direction(
    z: wp.array[wp.vec3], direction: wp.array[wp.vec3], scalars: wp.array[wp.float64], first: int
) -> None:
    """Make the next direction conjugate to the last."""
    i = wp.tid()
    if first == 1:
        direction[i] = z[i]
    else:
        ratio = float(0.0)
        if scalars[_RESIDUAL] > wp.float64(0.0):
            ratio = float(scalars[_RESIDUAL_NEXT] / scalars[_RESIDUAL])
        direction[i] = z[i] + direction[i] * ratio


@wp.kernel(enable_backward=False)
def shift_scalars(scalars: wp.array[wp.float64], first: int) -> None:
    """Make this iteration's residual the last one's."""
    if first == 0:
        scalars[_RESIDUAL] = scalars[_RESIDUAL_NEXT]
    scalars[_RESIDUAL_NEXT] = wp.float64(0.0)
    scalars[_CURVATURE] = wp.float64(0.0)


@wp.kernel(enable_backward=False)
def sum_curvature(
    direction: wp.array[wp.vec3], product: wp.array[wp.vec3], scalars: wp.array[wp.float64]
) -> None:
    """Sum the direction's energy."""
    i = wp.tid()
    wp.atomic_add(scalars, _CURVATURE, wp.float64(wp.dot(product[i], direction[i])))


@wp.kernel(enable_backward=False)
def advance(
    inverse: wp.array[wp.mat33],
    direction: wp.array[wp.vec3],
    product: wp.array[wp.vec3],
    scalars: wp.array[wp.float64],
    change: wp.array[wp.vec3],
    residual: wp.array[wp.vec3],
    z: wp.array[wp.vec3],
) -> None:
    """Go along the direction to where the residual is least."""
    i = wp.tid()
    if scalars[_CURVATURE] > wp.float64(0.0):
        length = float(scalars[_RESIDUAL] / scalars[_CURVATURE])
        change[i] = change[i] + direction[i] * length
        residual[i] = residual[i] - product[i] * length
    z[i] = inverse[i] * residual[i]


@wp.kernel(enable_backward=False)
def add_rigid(
    cell: wp.array[int],
    center: wp.array[wp.vec3],
    modes: wp.array[float],
    position: wp.array[wp.vec3],
    change: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
) -> None:
    """Add what the coarse space still finds, and take the whole change over."""
    i = wp.tid()
    whole = change[i] + prolong(cell[i], position[i] - center[cell[i]], modes)
    if not wp.isfinite(whole):
        whole = wp.vec3()
    change[i] = whole
    velocity[i] = velocity[i] + whole


class ConjugateGradients:
    """Work arrays and the iteration.

    Args:
        particle_count: Number of particles.
        device: Warp device.
    """

    def __init__(self, particle_count: int, device: wp.Device) -> None:
        self.device = device
        self.particle_count = particle_count
        vectors: dict[str, Any] = {"dtype": wp.vec3, "device": device}
        self.residual = wp.zeros(particle_count, **vectors)
        self.z = wp.zeros(particle_count, **vectors)
        self.direction = wp.zeros(particle_count, **vectors)
        self.product = wp.zeros(particle_count, **vectors)
        self.change = wp.zeros(particle_count, **vectors)
        self.inverse = wp.zeros(particle_count, dtype=wp.mat33, device=device)
        self.pressure_change = wp.zeros(particle_count, dtype=float, device=device)
        self.scalars = wp.zeros(3, dtype=wp.float64, device=device)

    def _launch(self, kernel: wp.Kernel, *inputs: Any, dim: int | None = None) -> None:
        count = self.particle_count if dim is None else dim
        wp.launch(kernel, dim=count, inputs=list(inputs), device=self.device)

    def solve(
        self,
        iterations: int,
        clay: Clay,
        bodies: wp.array,
        material: wp.array,
        position: wp.array,
        pairs: Pairs,
        diagonal: wp.array,
        own_block: wp.array,
        coarse: CoarseSpace,
        velocity: wp.array,
    ) -> None:
        """Change velocities so that the residual impulse goes to zero.

        Args:
            iterations: How many.
            clay: What all pairs share.
            bodies: What particles of each material have of their own.
            material: Each particle's material.
            position: Positions at the start of the substep [m].
            pairs: The acting pairs with their tangent.
            diagonal: Each particle's block of the tangent [kg], contacts included.
            own_block: Mass and contacts alone [kg].
            coarse: The coarse space, factored.
            velocity: Velocities to change [m/s].
        """
        scalars = self.scalars
        rigid = (coarse.cell, coarse.center, coarse.modes, position)
        self._launch(invert_diagonal, diagonal, self.inverse)
        scalars.zero_()
        self._launch(start, self.inverse, self.residual, self.z, self.change)
        coarse.solve(position, self.residual)
        self._launch(finish_z, *rigid, self.residual, self.z, scalars, _RESIDUAL)
        for iteration in range(iterations):
            first = int(iteration == 0)
            self._launch(turn_direction, self.z, self.direction, scalars, first)
            self._launch(shift_scalars, scalars, first, dim=1)
            pairs.multiply(
                clay,
                bodies,
                material,
                own_block,
                self.direction,
                self.pressure_change,
                self.product,
            )
            self._launch(sum_curvature, self.direction, self.product, scalars)
            self._launch(
                advance,
                self.inverse,
                self.direction,
                self.product,
                scalars,
                self.change,
                self.residual,
                self.z,
            )
            coarse.solve(position, self.residual)
            if iteration + 1 < iterations:
                self._launch(finish_z, *rigid, self.residual, self.z, scalars, _RESIDUAL_NEXT)
        self._launch(add_rigid, *rigid, self.change, velocity)
