# SPDX-License-Identifier: GPL-3.0-or-later
"""Preconditioned conjugate gradients for a Newton step of the pair forces and contacts.

Sums over all particles are gathered by the passes that compute their terms, in one entry per
iteration, so that an iteration takes four passes: two for the product, `advance` and `turn`.
"""

import sys

import warp as wp

from ...core.awake import Awake, awake_particle
from ...core.particles import ByPart, Particles, zeros_with_room
from ..law_data import SharedLaw
from ..pairs.pairs import Pairs
from ..pairs.products import motion
from . import conjugate_gradients_cpu
from .coarse_space import CoarseSpace, add_to_modes, prolong
from .data import Solve


@wp.func
def precondition(solve: Solve, part: int, i: int, residual: wp.vec3, iteration: int) -> None:
    """Store a particle's residual, and add it to the sums over all particles."""
    solve.residual[i] = residual
    z = solve.inverse[i] * residual
    solve.z[i] = z
    wp.atomic_add(solve.size, part, iteration, wp.float64(wp.dot(z, residual)))
    own = solve.cell[i]
    add_to_modes(solve.sums, part, own, solve.position[i] - solve.center[own], residual)


@wp.func
def residual_size(solve: Solve, part: int, iteration: int) -> wp.float64:
    """Preconditioned square of the whole residual [J]."""
    total = solve.coarse_size[part, iteration]
    for other in range(solve.size.shape[0]):
        total += solve.size[other, iteration]
    return total


@wp.kernel(enable_backward=False)
def start(awake: Awake, diagonal: wp.array[wp.mat33], solve: Solve) -> None:
    """Start from zero change."""
    i = awake_particle(awake, wp.tid())
    if i < 0:
        return
    # Scaled to order one, because the determinant of a small particle's block would underflow.
    scale = 1.0 / wp.trace(diagonal[i])
    solve.inverse[i] = wp.inverse(diagonal[i] * scale) * scale
    solve.change[i] = wp.vec3()
    precondition(solve, awake.part, i, solve.residual[i], 0)


@wp.kernel(enable_backward=False)
def turn(awake: Awake, iteration: int, solve: Solve) -> None:
    """Compute the next search direction, conjugate to the last."""
    i = awake_particle(awake, wp.tid())
    if i < 0:
        return
    own = solve.cell[i]
    z = solve.z[i] + prolong(own, solve.position[i] - solve.center[own], solve.modes, awake.part)
    if iteration > 0:
        before = residual_size(solve, awake.part, iteration - 1)
        if before > wp.float64(0.0):
            now = residual_size(solve, awake.part, iteration)
            z += motion(solve.direction[i]) * float(now / before)
    solve.direction[i] = wp.vec4(z[0], z[1], z[2], 0.0)


@wp.kernel(enable_backward=False)
def advance(awake: Awake, iteration: int, solve: Solve) -> None:
    """Move along the search direction to the minimum."""
    i = awake_particle(awake, wp.tid())
    if i < 0:
        return
    length = float(0.0)
    curvature = wp.float64(0.0)
    for part in range(solve.curvature.shape[0]):
        curvature += solve.curvature[part, iteration]
    if curvature > wp.float64(0.0):
        length = float(residual_size(solve, awake.part, iteration) / curvature)
    solve.change[i] = solve.change[i] + motion(solve.direction[i]) * length
    missing = solve.residual[i] - solve.product[i] * length
    precondition(solve, awake.part, i, missing, iteration + 1)


@wp.kernel(enable_backward=False)
def finish(awake: Awake, solve: Solve, velocity: wp.array[wp.vec3]) -> None:
    """Add the last correction of the coarse space, and apply the whole change."""
    i = awake_particle(awake, wp.tid())
    if i < 0:
        return
    own = solve.cell[i]
    whole = solve.change[i] + prolong(
        own, solve.position[i] - solve.center[own], solve.modes, awake.part
    )
    if not wp.isfinite(whole):
        whole = wp.vec3()
    solve.change[i] = whole
    velocity[i] = velocity[i] + whole


_PLAIN = sys.modules[__name__]


class ConjugateGradients:
    """Work arrays and the iteration.

    Args:
        particles: The particles whose velocities are solved for.
        max_iterations: Largest number of iterations of a solve.
    """

    def __init__(self, particles: Particles, max_iterations: int) -> None:
        self.particles = particles
        count, device = particles.count, particles.device
        solve = Solve()
        for name in ("residual", "z", "product", "change"):
            setattr(solve, name, zeros_with_room(count, wp.vec3, device))
        solve.direction = wp.zeros(count, dtype=wp.vec4, device=device)
        solve.inverse = zeros_with_room(count, wp.mat33, device)
        for name in ("size", "curvature", "coarse_size"):
            shape = (particles.parts, max_iterations + 1)
            setattr(solve, name, wp.zeros(shape, dtype=wp.float64, device=device))
        solve.position = particles.position
        self.data = solve

    @property
    def residual(self) -> wp.array:
        """Residual impulse of each particle [N s]; to be filled before `solve`."""
        return self.data.residual

    @property
    def change(self) -> wp.array:
        """Velocity changes of the last solve [m/s]."""
        return self.data.change

    def solve(
        self,
        iterations: int,
        shared: SharedLaw,
        particle_laws: wp.array,
        pairs: Pairs,
        diagonal: wp.array,
        own_block: wp.array,
        coarse: CoarseSpace,
    ) -> None:
        """Change velocities so that the residual impulse goes to zero.

        Args:
            iterations: Number of iterations.
            shared: Values that all pairs share.
            particle_laws: Values of particles of each material.
            pairs: The acting pairs with their tangent.
            diagonal: Diagonal block of the tangent for each particle [kg], contacts included.
            own_block: Mass and contact stiffness alone [kg].
            coarse: The coarse space, factored.
        """
        data = self.data
        on_cpu = self.particles.device.is_cpu
        passes = conjugate_gradients_cpu if on_cpu else _PLAIN
        launch = self.particles.launch_blocks if on_cpu else self.particles.launch
        data.cell, data.center = coarse.cell, coarse.center
        data.sums, data.modes = coarse.sums, coarse.modes
        for sums in (data.size, data.curvature, data.coarse_size, data.sums):
            self.particles.zero(ByPart.rows(sums))
        launch(passes.start, diagonal, data)
        coarse.solve(data.coarse_size, 0)
        for iteration in range(iterations):
            launch(passes.turn, iteration, data)
            pairs.multiply(
                shared,
                particle_laws,
                own_block,
                data.direction,
                data.product,
                data.curvature,
                iteration,
            )
            self.particles.zero(ByPart.rows(data.sums))
            launch(passes.advance, iteration, data)
            coarse.solve(data.coarse_size, iteration + 1)
        launch(passes.finish, data, self.particles.velocity)
