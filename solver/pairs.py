# SPDX-License-Identifier: GPL-3.0-or-later
"""The acting pairs of a scene and the passes over them."""

from typing import Any

import warp as wp

from . import pair_rows_cpu
from .bond_law import Clay
from .neighbors import Neighbors
from .pair_rows import (
    MOST_PAIRS,
    PairRows,
    flow_pairs,
    gather_pairs,
    measure_pairs,
    multiply_pairs,
    press_pairs,
    sum_forces,
)


class Pairs:
    """The acting pairs and the passes over them.

    Args:
        particle_count: Number of particles.
        device: Warp device.
    """

    def __init__(self, particle_count: int, device: wp.Device) -> None:
        self.device = device
        self.particle_count = particle_count
        rows = PairRows()
        shape = (particle_count, MOST_PAIRS)
        for name in ("other", "slot"):
            setattr(rows, name, wp.zeros(shape, dtype=int, device=device))
        for name in (
            "length",
            "direction_x",
            "direction_y",
            "direction_z",
            "distance",
            "distance_next",
            "stiffness",
            "slope",
        ):
            setattr(rows, name, wp.zeros(shape, dtype=float, device=device))
        rows.count = wp.zeros(particle_count, dtype=int, device=device)
        rows.mean_stretch = wp.zeros(particle_count, dtype=float, device=device)
        rows.compression = wp.zeros(particle_count, dtype=float, device=device)
        self.rows = rows
        self.overflow = wp.zeros(1, dtype=int, device=device)
        self._measure, self._press, self._multiply = measure_pairs, press_pairs, multiply_pairs
        if device.is_cpu:
            self._measure = pair_rows_cpu.measure_pairs
            self._press = pair_rows_cpu.press_pairs
            self._multiply = pair_rows_cpu.multiply_pairs

    def _launch(self, kernel: wp.Kernel, *inputs: Any) -> None:
        wp.launch(kernel, dim=self.particle_count, inputs=list(inputs), device=self.device)

    def gather(self, clay: Clay, position: wp.array, neighbors: Neighbors) -> None:
        """Collect the pairs that act from here."""
        self._launch(
            gather_pairs,
            clay,
            position,
            neighbors.count,
            neighbors.index,
            neighbors.rest_length,
            self.rows,
            self.overflow,
        )

    def measure(self, clay: Clay, velocity: wp.array) -> None:
        """Find lengths and volumes at the end of a substep with these velocities."""
        self._launch(self._measure, clay, velocity, self.rows)

    def sum_forces(
        self,
        clay: Clay,
        pair_laws: wp.array,
        bodies: wp.array,
        material: wp.array,
        velocity_free: wp.array,
        velocity: wp.array,
        residual: wp.array,
        diagonal: wp.array,
    ) -> None:
        """Residual impulse and tangent at these velocities; `measure` comes first."""
        self._launch(
            sum_forces,
            clay,
            pair_laws,
            bodies,
            material,
            velocity_free,
            velocity,
            self.rows,
            residual,
            diagonal,
        )

    def multiply(
        self,
        clay: Clay,
        bodies: wp.array,
        material: wp.array,
        own_block: wp.array,
        direction: wp.array,
        pressure_change: wp.array,
        product: wp.array,
    ) -> None:
        """Multiply a direction [m/s] by the tangent; `sum_forces` comes first."""
        time_step = clay.time_step
        self._launch(
            self._press, bodies, material, time_step, self.rows, direction, pressure_change
        )
        self._launch(self._multiply, self.rows, own_block, pressure_change, direction, product)

    def flow(
        self, clay: Clay, pair_laws: wp.array, material: wp.array, neighbors: Neighbors
    ) -> None:
        """Write the rest lengths after flow; `measure` at the final velocities comes first."""
        self._launch(flow_pairs, clay, pair_laws, material, self.rows, neighbors.rest_length)
