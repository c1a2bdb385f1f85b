# SPDX-License-Identifier: GPL-3.0-or-later
"""Gathering the pairs that act, and measuring density, stress and strain rate over them."""

import warp as wp

from ...core.awake import Awake, awake_particle
from ..law_data import ParticleLaw, SharedLaw
from ..law_functions import (
    bond_hold,
    bond_stretch,
    coincident_distance,
    compression_of,
    dilation_of,
    flow_share,
    kernel_value,
    pair_damping,
)
from .rows import PairRows, pair_direction, sort_row


@wp.func
def orient_row(shared: SharedLaw, position: wp.array[wp.vec3], pairs: PairRows, i: int) -> None:
    """Find the directions and distances of a particle's pairs."""
    floor = coincident_distance(shared)
    for slot in range(pairs.first[i], pairs.first[i] + pairs.acting[i]):
        j = pairs.other[slot]
        offset = position[j] - position[i]
        apart = wp.length(offset)
        direction = offset / wp.max(apart, floor)
        if apart <= floor:
            # Coincident particles separate along a direction that both ends agree on.
            seed = wp.rand_init(wp.min(i, j), wp.max(i, j))
            direction = wp.sample_unit_sphere_surface(seed)
            if i > j:
                direction = -direction
        pairs.direction_x[slot] = direction[0]
        pairs.direction_y[slot] = direction[1]
        pairs.direction_z[slot] = direction[2]
        pairs.distance[slot] = wp.max(apart, floor)


@wp.func
def measure_row(
    shared: SharedLaw,
    particle_laws: wp.array[ParticleLaw],
    material: wp.array[int],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
    i: int,
) -> None:
    """Find the lengths of a particle's pairs at the end of the substep, and its condition."""
    v = velocity[i]
    neighbors = float(0.0)
    lopsided = wp.vec3()
    lengths = float(0.0)
    squares = float(0.0)
    parting = float(0.0)
    rates = float(0.0)
    stretch = wp.mat33()
    for slot in range(pairs.first[i], pairs.first[i] + pairs.acting[i]):
        closing = velocity[pairs.other[slot]] - v
        n = pair_direction(pairs, slot)
        before = pairs.distance[slot]
        apart = wp.length(n * before + closing * shared.time_step)
        pairs.distance_next[slot] = apart
        value = kernel_value(shared, apart)
        neighbors += value
        lopsided += n * value
        speed = wp.dot(n, closing)
        squares += apart * apart
        parting += apart * speed
        rates += speed * speed
        rest = pairs.rest_length[slot]
        if rest > 0.0:
            hold = bond_hold(shared, rest)
            lengths += hold * rest * rest
            stretch += wp.outer(n, n) * bond_stretch(shared, hold, rest, apart)
    own = particle_laws[material[i]]
    pairs.condition[i] = wp.vec4(
        compression_of(shared, neighbors, wp.length(lopsided)),
        dilation_of(shared, wp.trace(stretch), lengths),
        flow_share(shared, own, stretch),
        pair_damping(shared, own, squares, parting, rates),
    )


@wp.kernel(enable_backward=False)
def gather_pairs(
    awake: Awake,
    shared: SharedLaw,
    particle_laws: wp.array[ParticleLaw],
    material: wp.array[int],
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
) -> None:
    """Find the pairs that act with their directions and distances, and measure particles."""
    i = awake_particle(awake, wp.tid())
    if i >= 0:
        sort_row(shared, position, pairs, i)
        orient_row(shared, position, pairs, i)
        measure_row(shared, particle_laws, material, velocity, pairs, i)


@wp.kernel(enable_backward=False)
def measure_pairs(
    awake: Awake,
    shared: SharedLaw,
    particle_laws: wp.array[ParticleLaw],
    material: wp.array[int],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
) -> None:
    """Find each pair's length at the end of the substep, and each particle's condition."""
    i = awake_particle(awake, wp.tid())
    if i >= 0:
        measure_row(shared, particle_laws, material, velocity, pairs, i)
