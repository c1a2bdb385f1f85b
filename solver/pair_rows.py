# SPDX-License-Identifier: GPL-3.0-or-later
"""The pairs that act in a substep, and the forces between them.

Every pair is kept at both ends, so that each particle gathers its own sum. Both ends compute the
same numbers from the same values, so forces are equal and opposite and rest lengths stay equal,
but for rounding. A pair's direction is that at the start of the substep, its length that at the
end: so pair forces conserve angular momentum exactly.
"""

import warp as wp

from .bond_law import Body, Clay, PairLaw, flow_bond, kernel_slope, kernel_value

MOST_PAIRS = 48
"""Pairs of one particle that can act at once."""


@wp.struct
class PairRows:
    """The acting pairs of all particles, a row of `MOST_PAIRS` for each."""

    count: wp.array[int]
    other: wp.array2d[int]
    slot: wp.array2d[int]
    """Where the pair's rest length is kept among the neighbours."""
    length: wp.array2d[float]
    """Rest length at the start of the substep [m], 0 for a free pair."""
    direction_x: wp.array2d[float]
    direction_y: wp.array2d[float]
    direction_z: wp.array2d[float]
    """Towards the other, at the start of the substep; kept by axis for vector units."""
    distance: wp.array2d[float]
    """At the start of the substep [m]."""
    distance_next: wp.array2d[float]
    """At its end [m]."""
    stiffness: wp.array2d[float]
    """Tangent of the bond [kg]: force derivative times Δt²."""
    slope: wp.array2d[float]
    """How fast the pair's share of the density falls with distance [1/m]."""
    mean_stretch: wp.array[float]
    """Mean stretch of a particle's bonds [m]."""
    compression: wp.array[float]
    """Density over that at rest, less one, where positive."""


@wp.func
def pair_direction(pairs: PairRows, i: int, e: int) -> wp.vec3:
    """Unit vector from a particle to the other end of a pair."""
    return wp.vec3(pairs.direction_x[i, e], pairs.direction_y[i, e], pairs.direction_z[i, e])


@wp.kernel(enable_backward=False)
def gather_pairs(
    clay: Clay,
    position: wp.array[wp.vec3],
    neighbor_count: wp.array[int],
    neighbor_index: wp.array2d[int],
    rest_length: wp.array2d[float],
    pairs: PairRows,
    overflow: wp.array[int],
) -> None:
    """Collect bonded pairs and free ones close enough to press, and count new bonds in."""
    i = wp.tid()
    x = position[i]
    used = int(0)
    floor = 1.0e-6 * clay.spacing
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
                direction = offset / wp.max(apart, floor)
                if apart <= floor:
                    # Coincident particles part along a direction that both ends agree on.
                    seed = wp.rand_init(wp.min(i, j), wp.max(i, j))
                    direction = wp.sample_unit_sphere_surface(seed)
                    if i > j:
                        direction = -direction
                pairs.other[i, used] = j
                pairs.slot[i, used] = s
                pairs.length[i, used] = wp.max(rest, 0.0)
                pairs.direction_x[i, used] = direction[0]
                pairs.direction_y[i, used] = direction[1]
                pairs.direction_z[i, used] = direction[2]
                pairs.distance[i, used] = wp.max(apart, floor)
                used += 1
            else:
                wp.atomic_add(overflow, 0, 1)
    pairs.count[i] = used


@wp.kernel(enable_backward=False)
def measure_pairs(clay: Clay, velocity: wp.array[wp.vec3], pairs: PairRows) -> None:
    """Find each pair's length at the end of the substep, and each particle's state of volume."""
    i = wp.tid()
    v = velocity[i]
    density = clay.inverse_rest_sum
    stretch = float(0.0)
    bonds = float(0.0)
    for e in range(pairs.count[i]):
        closing = velocity[pairs.other[i, e]] - v
        way = pair_direction(pairs, i, e) * pairs.distance[i, e] + closing * clay.time_step
        apart = wp.length(way)
        pairs.distance_next[i, e] = apart
        density += kernel_value(clay, apart)
        rest = pairs.length[i, e]
        if rest > 0.0:
            stretch += apart - rest
            bonds += 1.0
    pairs.mean_stretch[i] = stretch / wp.max(bonds, 1.0)
    pairs.compression[i] = wp.max(density - 1.0, 0.0)


@wp.kernel(enable_backward=False)
def sum_forces(
    clay: Clay,
    pair_laws: wp.array[PairLaw],
    bodies: wp.array[Body],
    material: wp.array[int],
    velocity_free: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
    residual: wp.array[wp.vec3],
    diagonal: wp.array[wp.mat33],
) -> None:
    """Impulse still missing at each particle [N s], and the tangent of the forces [kg]."""
    i = wp.tid()
    dt = clay.time_step
    own = material[i]
    body = bodies[own]
    compression = pairs.compression[i]
    mean_stretch = pairs.mean_stretch[i]
    pressure = body.pressure_stiffness * compression
    force = wp.vec3()
    slope_sum = wp.vec3()
    block = wp.identity(n=3, dtype=float) * body.mass
    for e in range(pairs.count[i]):
        j = pairs.other[i, e]
        apart = pairs.distance_next[i, e]
        n = pair_direction(pairs, i, e)
        a = kernel_slope(clay, apart)
        other_compression = pairs.compression[j]
        other_stiffness = bodies[material[j]].pressure_stiffness
        pull = -(pressure + other_stiffness * other_compression) * a
        k = float(0.0)
        rest = pairs.length[i, e]
        if rest > 0.0:
            law = pair_laws[own * clay.material_count + material[j]]
            pressed = compression + other_compression > 0.0
            bond = flow_bond(clay, law, rest, apart, mean_stretch + pairs.mean_stretch[j], pressed)
            pull += law.stiffness * (apart - bond.rest_length)
            k = law.stiffness * bond.softening * dt * dt
        force += n * pull
        pairs.stiffness[i, e] = k
        pairs.slope[i, e] = a
        slope_sum += n * a
        w = k
        if other_compression > 0.0:
            w += other_stiffness * dt * dt * a * a
        block += wp.outer(n, n) * w
    if compression > 0.0:
        block += wp.outer(slope_sum, slope_sum) * (body.pressure_stiffness * dt * dt)
    residual[i] = (velocity_free[i] - velocity[i]) * body.mass + force * dt
    diagonal[i] = block


@wp.kernel(enable_backward=False)
def flow_pairs(
    clay: Clay,
    pair_laws: wp.array[PairLaw],
    material: wp.array[int],
    pairs: PairRows,
    rest_length: wp.array2d[float],
) -> None:
    """Keep what flowed: write the bonds' new rest lengths, and drop those that broke."""
    i = wp.tid()
    for e in range(pairs.count[i]):
        rest = pairs.length[i, e]
        if rest > 0.0:
            j = pairs.other[i, e]
            law = pair_laws[material[i] * clay.material_count + material[j]]
            pressed = pairs.compression[i] + pairs.compression[j] > 0.0
            stretch = pairs.mean_stretch[i] + pairs.mean_stretch[j]
            apart = pairs.distance_next[i, e]
            rest = flow_bond(clay, law, rest, apart, stretch, pressed).rest_length
            if wp.max(apart, rest) > clay.break_length:
                rest = 0.0
            rest_length[i, pairs.slot[i, e]] = rest


@wp.kernel(enable_backward=False)
def press_pairs(
    bodies: wp.array[Body],
    material: wp.array[int],
    time_step: float,
    pairs: PairRows,
    direction: wp.array[wp.vec3],
    pressure_change: wp.array[float],
) -> None:
    """How a motion changes the pressure of compressed particles [kg m]."""
    i = wp.tid()
    total = float(0.0)
    if pairs.compression[i] > 0.0:
        p = direction[i]
        for e in range(pairs.count[i]):
            closing = wp.dot(pair_direction(pairs, i, e), p - direction[pairs.other[i, e]])
            total += pairs.slope[i, e] * closing
    scale = bodies[material[i]].pressure_stiffness * time_step * time_step
    pressure_change[i] = total * scale


@wp.kernel(enable_backward=False)
def multiply_pairs(
    pairs: PairRows,
    own_block: wp.array[wp.mat33],
    pressure_change: wp.array[float],
    direction: wp.array[wp.vec3],
    product: wp.array[wp.vec3],
) -> None:
    """Multiply a direction by the tangent: mass, contacts, bonds and pressure."""
    i = wp.tid()
    p = direction[i]
    total = own_block[i] * p
    own = pressure_change[i]
    for e in range(pairs.count[i]):
        j = pairs.other[i, e]
        n = pair_direction(pairs, i, e)
        closing = wp.dot(n, p - direction[j])
        pull = pairs.stiffness[i, e] * closing + pairs.slope[i, e] * (own + pressure_change[j])
        total += n * pull
    product[i] = total
