# SPDX-License-Identifier: GPL-3.0-or-later
"""The pairs that act in a substep, and the forces between them.

Every pair is kept at both ends, so that each particle gathers its own sum. Both ends compute the
same numbers from the same values, so forces are equal and opposite and rest lengths stay equal
bit for bit. A pair's direction is that at the start of the substep, its length that at the end:
so pair forces conserve angular momentum exactly.
"""

import warp as wp

from .bond_law import Body, Clay, PairLaw, flow_bond, kernel_slope, kernel_value
from .neighbors import SLOTS, Neighbors

MOST_PAIRS = 48
"""Pairs of one particle that can act at once."""


@wp.kernel(enable_backward=False)
def gather_pairs(
    clay: Clay,
    position: wp.array[wp.vec3],
    neighbor_count: wp.array[int],
    neighbor_index: wp.array2d[int],
    rest_length: wp.array2d[float],
    count: wp.array[int],
    other: wp.array2d[int],
    slot: wp.array2d[int],
    length: wp.array2d[float],
    direction: wp.array2d[wp.vec3],
    distance: wp.array2d[float],
    overflow: wp.array[int],
) -> None:
    """Collect bonded pairs and free ones close enough to press, and count new bonds in."""
    i = wp.tid()
    x = position[i]
    used = int(0)
    for s in range(neighbor_count[i]):
        j = neighbor_index[i, s]
        offset = position[j] - x
        apart = wp.length(offset)
        rest = rest_length[i, s]
        if rest <= 0.0:
            if apart < clay.form_reach:
                if clay.bonds == 1:
                    rest -= 1.0
                    if rest < -clay.dwell:
                        rest = wp.max(apart, clay.shortest_length)
                else:
                    rest = -1.0
            else:
                rest = 0.0
            rest_length[i, s] = rest
        if rest != 0.0:
            if used < MOST_PAIRS:
                other[i, used] = j
                slot[i, used] = s
                length[i, used] = wp.max(rest, 0.0)
                floor = 1.0e-6 * clay.spacing
                if apart > floor:
                    direction[i, used] = offset / apart
                else:
                    # Coincident particles part along a direction that both ends agree on.
                    seed = wp.rand_init(wp.min(i, j), wp.max(i, j))
                    away = wp.sample_unit_sphere_surface(seed)
                    direction[i, used] = wp.where(i < j, away, -away)
                distance[i, used] = wp.max(apart, floor)
                used += 1
            else:
                wp.atomic_add(overflow, 0, 1)
    count[i] = used


@wp.kernel(enable_backward=False)
def measure_stretch(
    clay: Clay,
    count: wp.array[int],
    other: wp.array2d[int],
    length: wp.array2d[float],
    direction: wp.array2d[wp.vec3],
    distance: wp.array2d[float],
    velocity: wp.array[wp.vec3],
    distance_next: wp.array2d[float],
    mean_stretch: wp.array[float],
    compression: wp.array[float],
) -> None:
    """Find each pair's length at the end of the substep, and each particle's state of volume."""
    i = wp.tid()
    v = velocity[i]
    density = clay.inverse_rest_sum
    stretch = float(0.0)
    bonds = float(0.0)
    for e in range(count[i]):
        way = direction[i, e] * distance[i, e] + (velocity[other[i, e]] - v) * clay.time_step
        apart = wp.length(way)
        distance_next[i, e] = apart
        density += kernel_value(clay, apart)
        rest = length[i, e]
        if rest > 0.0:
            stretch += apart - rest
            bonds += 1.0
    mean_stretch[i] = stretch / wp.max(bonds, 1.0)
    compression[i] = wp.max(density - 1.0, 0.0)


@wp.kernel(enable_backward=False)
def sum_forces(
    clay: Clay,
    pair_laws: wp.array[PairLaw],
    bodies: wp.array[Body],
    material: wp.array[int],
    count: wp.array[int],
    other: wp.array2d[int],
    length: wp.array2d[float],
    direction: wp.array2d[wp.vec3],
    distance_next: wp.array2d[float],
    mean_stretch: wp.array[float],
    compression: wp.array[float],
    velocity_free: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    stiffness: wp.array2d[float],
    slope: wp.array2d[float],
    residual: wp.array[wp.vec3],
    diagonal: wp.array[wp.mat33],
) -> None:
    """Impulse still missing at each particle [N s], and the tangent of the forces.

    ``stiffness`` and ``diagonal`` are in kg: force derivative times Δt².
    """
    i = wp.tid()
    dt = clay.time_step
    own = material[i]
    body = bodies[own]
    pressure = body.pressure_stiffness * compression[i]
    force = wp.vec3()
    slope_sum = wp.vec3()
    block = wp.identity(n=3, dtype=float) * body.mass
    for e in range(count[i]):
        j = other[i, e]
        apart = distance_next[i, e]
        n = direction[i, e]
        a = kernel_slope(clay, apart)
        theirs = bodies[material[j]].pressure_stiffness
        pull = -(pressure + theirs * compression[j]) * a
        k = float(0.0)
        rest = length[i, e]
        if rest > 0.0:
            law = pair_laws[own * clay.material_count + material[j]]
            pressed = compression[i] + compression[j] > 0.0
            bond = flow_bond(clay, law, rest, apart, mean_stretch[i] + mean_stretch[j], pressed)
            pull += law.stiffness * (apart - bond.rest_length)
            k = law.stiffness * bond.softening * dt * dt
        force += n * pull
        stiffness[i, e] = k
        slope[i, e] = a
        slope_sum += n * a
        w = k
        if compression[j] > 0.0:
            w += theirs * dt * dt * a * a
        block += wp.outer(n, n) * w
    if compression[i] > 0.0:
        block += wp.outer(slope_sum, slope_sum) * (body.pressure_stiffness * dt * dt)
    residual[i] = (velocity_free[i] - velocity[i]) * body.mass + force * dt
    diagonal[i] = block


@wp.kernel(enable_backward=False)
def flow_pairs(
    clay: Clay,
    pair_laws: wp.array[PairLaw],
    material: wp.array[int],
    count: wp.array[int],
    other: wp.array2d[int],
    slot: wp.array2d[int],
    length: wp.array2d[float],
    distance_next: wp.array2d[float],
    mean_stretch: wp.array[float],
    compression: wp.array[float],
    rest_length: wp.array2d[float],
) -> None:
    """Keep what flowed: write the bonds' new rest lengths, and drop those that broke."""
    i = wp.tid()
    for e in range(count[i]):
        rest = length[i, e]
        if rest > 0.0:
            j = other[i, e]
            law = pair_laws[material[i] * clay.material_count + material[j]]
            pressed = compression[i] + compression[j] > 0.0
            apart = distance_next[i, e]
            bond = flow_bond(clay, law, rest, apart, mean_stretch[i] + mean_stretch[j], pressed)
            rest = bond.rest_length
            if wp.max(apart, rest) > clay.break_length:
                rest = 0.0
            rest_length[i, slot[i, e]] = rest


class Pairs:
    """Arrays of the acting pairs.

    Args:
        particle_count: Number of particles.
        device: Warp device.
    """

    def __init__(self, particle_count: int, device: wp.Device) -> None:
        rows = (particle_count, min(MOST_PAIRS, SLOTS))
        self.device = device
        self.particle_count = particle_count
        self.count = wp.zeros(particle_count, dtype=int, device=device)
        self.other = wp.zeros(rows, dtype=int, device=device)
        self.slot = wp.zeros(rows, dtype=int, device=device)
        self.length = wp.zeros(rows, dtype=float, device=device)
        self.direction = wp.zeros(rows, dtype=wp.vec3, device=device)
        self.distance = wp.zeros(rows, dtype=float, device=device)
        self.distance_next = wp.zeros(rows, dtype=float, device=device)
        self.stiffness = wp.zeros(rows, dtype=float, device=device)
        self.slope = wp.zeros(rows, dtype=float, device=device)
        self.mean_stretch = wp.zeros(particle_count, dtype=float, device=device)
        self.compression = wp.zeros(particle_count, dtype=float, device=device)
        self.overflow = wp.zeros(1, dtype=int, device=device)

    def gather(self, clay: Clay, position: wp.array, neighbors: Neighbors) -> None:
        """Collect the pairs that act from here."""
        wp.launch(
            gather_pairs,
            dim=self.particle_count,
            inputs=[
                clay,
                position,
                neighbors.count,
                neighbors.index,
                neighbors.rest_length,
                self.count,
                self.other,
                self.slot,
                self.length,
                self.direction,
                self.distance,
                self.overflow,
            ],
            device=self.device,
        )

    def measure(self, clay: Clay, velocity: wp.array) -> None:
        """Find lengths and volumes at the end of a substep with these velocities."""
        wp.launch(
            measure_stretch,
            dim=self.particle_count,
            inputs=[
                clay,
                self.count,
                self.other,
                self.length,
                self.direction,
                self.distance,
                velocity,
                self.distance_next,
                self.mean_stretch,
                self.compression,
            ],
            device=self.device,
        )

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
        wp.launch(
            sum_forces,
            dim=self.particle_count,
            inputs=[
                clay,
                pair_laws,
                bodies,
                material,
                self.count,
                self.other,
                self.length,
                self.direction,
                self.distance_next,
                self.mean_stretch,
                self.compression,
                velocity_free,
                velocity,
                self.stiffness,
                self.slope,
                residual,
                diagonal,
            ],
            device=self.device,
        )

    def flow(
        self, clay: Clay, pair_laws: wp.array, material: wp.array, neighbors: Neighbors
    ) -> None:
        """Write the rest lengths after flow; `measure` at the final velocities comes first."""
        wp.launch(
            flow_pairs,
            dim=self.particle_count,
            inputs=[
                clay,
                pair_laws,
                material,
                self.count,
                self.other,
                self.slot,
                self.length,
                self.distance_next,
                self.mean_stretch,
                self.compression,
                neighbors.rest_length,
            ],
            device=self.device,
        )
