# SPDX-License-Identifier: GPL-3.0-or-later
"""The acting pairs of a scene and the passes over them."""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ...core.particles import Particles
from ..law_data import SharedLaw
from . import forces, forces_cpu, measures, measures_cpu, products, products_cpu
from .rows import MAX_SLOTS, PairRows

_BY_SLOT = (
    "direction_x",
    "direction_y",
    "direction_z",
    "distance",
    "distance_next",
    "stiffness",
    "slope",
)


@wp.kernel(enable_backward=False)
def copy_rows(before: PairRows, after: PairRows) -> None:
    """Copy neighbors and rest lengths to another layout."""
    i = wp.tid()
    for e in range(after.listed[i]):
        after.other[after.first[i] + e] = before.other[before.first[i] + e]
        after.rest_length[after.first[i] + e] = before.rest_length[before.first[i] + e]


@wp.kernel(enable_backward=False)
def move_rows(
    index: wp.array[int], first: wp.array[int], room: wp.array[int], pairs: PairRows
) -> None:
    """Move some rows to slots with more room."""
    i = index[wp.tid()]
    start = first[wp.tid()]
    for e in range(pairs.listed[i]):
        pairs.other[start + e] = pairs.other[pairs.first[i] + e]
        pairs.rest_length[start + e] = pairs.rest_length[pairs.first[i] + e]
    pairs.first[i] = start
    pairs.room[i] = room[wp.tid()]


def _room_for(needed: NDArray[np.int32]) -> NDArray[np.int32]:
    """Number of slots to give to rows: a few more than needed, so that rows seldom move."""
    return (np.minimum(needed + 4, MAX_SLOTS) + 7) // 8 * 8


class Pairs:
    """The rows of neighbors, and the passes over pairs that act.

    Args:
        particles: The particles that are paired.
    """

    def __init__(self, particles: Particles) -> None:
        self.particles = particles
        count, device = particles.count, particles.device
        self.rows = PairRows()
        for name in ("first", "room", "listed", "acting"):
            setattr(self.rows, name, wp.zeros(count, dtype=int, device=device))
        self.rows.condition = wp.zeros(count, dtype=wp.vec4, device=device)
        self.rows.resting = particles.resting
        self.generation = 0
        self._slots = self._used = 0
        self.rows.other = wp.zeros(0, dtype=int, device=device)
        self.rows.rest_length = wp.zeros(0, dtype=float, device=device)
        self.lay_out(np.zeros(count, np.int32))
        self._left = wp.zeros(count if device.is_cpu else 0, dtype=int, device=device)
        self._measures = measures_cpu if device.is_cpu else measures
        self._forces = forces_cpu if device.is_cpu else forces
        self._products = products_cpu if device.is_cpu else products
        self._launch = particles.launch_blocks if device.is_cpu else particles.launch

    def make_room(self, short: NDArray[np.int64], needed: NDArray[np.int32]) -> None:
        """Give some rows the room they need, at the end of the arrays if there is space.

        Args:
            short: Indices of the rows that are too short, shape [S].
            needed: Slots for each particle, shape [N].
        """
        rows, device = self.rows, self.particles.device
        room = _room_for(needed[short])
        total = self._used + int(room.sum())
        if total > self._slots:
            self.lay_out(needed)
            return
        first = self._used + np.cumsum(room) - room
        self._used = total
        index = wp.array(short, dtype=int, device=device)
        inputs = [
            index,
            wp.array(first, dtype=int, device=device),
            wp.array(room, dtype=int, device=device),
            rows,
        ]
        wp.launch(move_rows, dim=len(short), inputs=inputs, device=device)

    def lay_out(self, needed: NDArray[np.int32]) -> None:
        """Give every row as much room as it needs, keeping its contents.

        Args:
            needed: Slots for each particle, shape [N].
        """
        rows, device = self.rows, self.particles.device
        room = _room_for(needed)
        first = np.cumsum(room) - room
        before = PairRows()
        before.first, before.other = wp.clone(rows.first), wp.clone(rows.other)
        before.rest_length = wp.clone(rows.rest_length)
        total = self._used = int(room.sum())
        if total > self._slots:
            # Recordings refer to arrays: new ones should seldom be needed.
            self._slots = total + total // 3
            rows.other = wp.zeros(self._slots, dtype=int, device=device)
            for name in ("rest_length", *_BY_SLOT):
                setattr(rows, name, wp.zeros(self._slots, dtype=float, device=device))
            self.generation += 1
        rows.first.assign(first.astype(np.int32))
        rows.room.assign(room.astype(np.int32))
        wp.launch(copy_rows, dim=self.particles.count, inputs=[before, rows], device=device)

    def gather(self, shared: SharedLaw, particle_laws: wp.array) -> None:
        """Find the pairs that act at the current positions, and `measure` them."""
        particles = self.particles
        # The CPU's pass records the rows that it leaves to the plain functions.
        left = [self._left] if particles.device.is_cpu else []
        self._launch(
            self._measures.gather_pairs,
            shared,
            particle_laws,
            particles.material,
            particles.position,
            particles.velocity,
            self.rows,
            *left,
        )

    def measure(self, shared: SharedLaw, particle_laws: wp.array) -> None:
        """Find pair lengths and particles' conditions at the end of the substep."""
        particles = self.particles
        self._launch(
            self._measures.measure_pairs,
            shared,
            particle_laws,
            particles.material,
            particles.velocity,
            self.rows,
        )

    def sum_forces(
        self,
        shared: SharedLaw,
        pair_laws: wp.array,
        particle_laws: wp.array,
        residual: wp.array,
        diagonal: wp.array,
    ) -> None:
        """Find residual impulse and tangent at the current velocities; call `measure` first."""
        particles = self.particles
        self._launch(
            self._forces.sum_forces,
            shared,
            pair_laws,
            particle_laws,
            particles.material,
            particles.velocity_free,
            particles.velocity,
            self.rows,
            residual,
            diagonal,
        )

    def multiply(
        self,
        shared: SharedLaw,
        particle_laws: wp.array,
        own_block: wp.array,
        direction: wp.array,
        product: wp.array,
        curvature: wp.array,
        iteration: int,
    ) -> None:
        """Multiply a direction by the tangent; call `sum_forces` first.

        Args:
            shared: Values that all pairs share.
            particle_laws: Values of particles of each material.
            own_block: Mass and contact stiffness alone [kg].
            direction: Search direction [m/s]; the fourth component receives the pressure change.
            product: The product [N s].
            curvature: Direction times product, added to by part and iteration [J].
            iteration: Column of ``curvature``.
        """
        particles = self.particles
        self._launch(
            self._products.press_pairs,
            shared,
            particle_laws,
            particles.material,
            self.rows,
            direction,
        )
        self._launch(
            self._products.multiply_pairs,
            shared,
            self.rows,
            own_block,
            direction,
            product,
            curvature,
            iteration,
        )

    def flow(self, shared: SharedLaw, pair_laws: wp.array) -> None:
        """Write the rest lengths after flow, at the final velocities."""
        particles = self.particles
        self._launch(
            self._forces.flow_pairs,
            shared,
            pair_laws,
            particles.material,
            particles.velocity,
            self.rows,
        )
