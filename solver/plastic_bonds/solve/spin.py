# SPDX-License-Identifier: GPL-3.0-or-later
"""Spin of coarse cells, with which a substep's initial guess of the velocities turns.

In a rotating body, every velocity changes direction in a substep. A guess that does not turn
stretches all bonds by half the square of the angle: at 0.13 rad (300 rpm) by nearly a hundredth,
enough to make soft clay flow. So velocities are turned with their cell before anything yields.
This affects only the guess; the solution is the same.
"""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ...core.awake import Awake, awake_particle
from ...core.particles import Particles
from ...core.vector_units import BLOCK
from .coarse_space import CoarseSpace

MIN_ANGLE = 0.01
"""Cells that turn by less than this in a substep are left alone [rad]."""
_SUMS = 16


@wp.kernel(enable_backward=False)
def sum_motion(
    awake: Awake,
    cell: wp.array[int],
    center: wp.array[wp.vec3],
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    sums: wp.array2d[float],
) -> None:
    """Sum count, arms, velocities, moments and second moments of each cell's particles."""
    i = awake_particle(awake, wp.tid())
    if i < 0:
        return
    own = cell[i]
    arm = position[i] - center[own]
    v = velocity[i]
    moment = wp.cross(arm, v)
    for axis in range(3):
        wp.atomic_add(sums, own, axis, arm[axis])
        wp.atomic_add(sums, own, 3 + axis, v[axis])
        wp.atomic_add(sums, own, 6 + axis, moment[axis])
        wp.atomic_add(sums, own, 9 + axis, arm[axis] * arm[axis])
        wp.atomic_add(sums, own, 12 + axis, arm[axis] * arm[(axis + 1) % 3])
    wp.atomic_add(sums, own, 15, 1.0)


@wp.func
def turn_particle(
    turn: wp.array[wp.quat], cell: wp.array[int], velocity: wp.array[wp.vec3], i: int
) -> None:
    """Turn a velocity with its cell."""
    velocity[i] = wp.quat_rotate(turn[cell[i]], velocity[i])


@wp.kernel(enable_backward=False)
def turn_velocities(
    awake: Awake, turn: wp.array[wp.quat], cell: wp.array[int], velocity: wp.array[wp.vec3]
) -> None:
    """Turn velocities with their cells."""
    i = awake_particle(awake, wp.tid())
    if i >= 0:
        turn_particle(turn, cell, velocity, i)


@wp.kernel(enable_backward=False)
def turn_velocities_of_block(
    awake: Awake, turn: wp.array[wp.quat], cell: wp.array[int], velocity: wp.array[wp.vec3]
) -> None:
    """`turn_velocities`, a block of particles at a time."""
    block = wp.tid()
    for thread in range(block * BLOCK, wp.min((block + 1) * BLOCK, awake.count[0])):
        turn_particle(turn, cell, velocity, awake.index[thread])


class Spin:
    """The spin of coarse cells.

    Args:
        particles: The particles in the cells.
        coarse: The cells.
    """

    def __init__(self, particles: Particles, coarse: CoarseSpace) -> None:
        self.particles = particles
        self.coarse = coarse
        self.rate = np.zeros((0, 3))
        """Spin of each cell [rad/s], shape [C, 3]."""
        self._turn = wp.zeros(0, dtype=wp.quat, device=particles.device)
        self._time_step = 0.0

    def measure(self) -> None:
        """Find the cells' current spin."""
        particles, coarse = self.particles, self.coarse
        cells = len(coarse.center)
        sums = wp.zeros((cells, _SUMS), dtype=float, device=particles.device)
        particles.launch(
            sum_motion, coarse.cell, coarse.center, particles.position, particles.velocity, sums
        )
        self.rate = spin_rates(sums.numpy().astype(np.float64), particles.spacing)
        self._time_step = 0.0
        if cells != len(self._turn):
            self._turn = wp.zeros(cells, dtype=wp.quat, device=particles.device)

    def prepare(self, time_step: float) -> bool:
        """Prepare a substep of ``time_step`` [s], and tell whether anything turns in it."""
        angle = np.linalg.norm(self.rate, axis=1) * time_step
        if not (angle > MIN_ANGLE).any():
            return False
        if time_step != self._time_step:
            half = 0.5 * np.where(angle > MIN_ANGLE, angle, 0.0)[:, None]
            axis = self.rate * (time_step / np.maximum(angle, 1e-30)[:, None])
            turn = np.concatenate([np.sin(half) * axis, np.cos(half)], axis=1)
            self._turn.assign(turn.astype(np.float32))
            self._time_step = time_step
        return True

    def turn(self) -> None:
        """Turn the velocities; call `prepare` first."""
        self.particles.run(
            turn_velocities,
            turn_velocities_of_block,
            self._turn,
            self.coarse.cell,
            self.particles.velocity,
        )


def spin_rates(sums: NDArray[np.float64], spacing: float) -> NDArray[np.float64]:
    """Angular velocities of the cells [rad/s], shape [C, 3].

    Args:
        sums: The sums of `sum_motion`, shape [C, 16].
        spacing: Spacing of the particles [m].
    """
    count = np.maximum(sums[:, 15:], 1.0)
    arm, velocity = sums[:, :3], sums[:, 3:6]
    moment = sums[:, 6:9] - np.cross(arm, velocity) / count
    second = np.zeros((len(sums), 3, 3))
    for axis in range(3):
        other = (axis + 1) % 3
        second[:, axis, axis] = sums[:, 9 + axis]
        second[:, axis, other] = second[:, other, axis] = sums[:, 12 + axis]
    second -= arm[:, :, None] * arm[:, None] / count[:, None]
    trace = np.trace(second, axis1=1, axis2=2)[:, None, None]
    # The spin of a single particle or a straight row is undetermined; the last term makes it zero.
    inertia = trace * np.eye(3) - second + (0.1 * spacing**2) * np.eye(3)
    return np.linalg.solve(inertia, moment[:, :, None])[:, :, 0]
