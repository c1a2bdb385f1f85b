# SPDX-License-Identifier: GPL-3.0-or-later
"""Multiplying a search direction by the tangent of all pairs, without forming a matrix.

First each compressed particle finds how the motion changes its pressure, then each particle sums
the responses of the bonds, dampers and pressures of its pairs.
"""

import warp as wp

from ...core.awake import Awake, awake_particle
from ..law_data import ParticleLaw, SharedLaw
from ..law_functions import pressure_tangent, tangent_pull
from .rows import COMPRESSION, PairRows, pair_direction


@wp.func
def motion(direction: wp.vec4) -> wp.vec3:
    """Motion of a particle in a search direction, without its pressure change."""
    return wp.vec3(direction[0], direction[1], direction[2])


@wp.kernel(enable_backward=False)
def press_pairs(
    awake: Awake,
    shared: SharedLaw,
    particle_laws: wp.array[ParticleLaw],
    material: wp.array[int],
    pairs: PairRows,
    direction: wp.array[wp.vec4],
) -> None:
    """Find how a motion changes the pressure of compressed particles, and store it with it."""
    i = awake_particle(awake, wp.tid())
    if i < 0:
        return
    total = float(0.0)
    p = direction[i]
    if pairs.condition[i][COMPRESSION] > 0.0:
        for slot in range(pairs.first[i], pairs.first[i] + pairs.acting[i]):
            relative = motion(p) - motion(direction[pairs.other[slot]])
            total += pairs.slope[slot] * wp.dot(pair_direction(pairs, slot), relative)
    p[3] = total * pressure_tangent(shared, particle_laws[material[i]].pressure_stiffness)
    direction[i] = p


@wp.kernel(enable_backward=False)
def multiply_pairs(
    awake: Awake,
    shared: SharedLaw,
    pairs: PairRows,
    own_block: wp.array[wp.mat33],
    direction: wp.array[wp.vec4],
    product: wp.array[wp.vec3],
    curvature: wp.array2d[wp.float64],
    iteration: int,
) -> None:
    """Multiply a direction by the tangent: mass, contacts, bonds and pressure."""
    i = awake_particle(awake, wp.tid())
    if i < 0:
        return
    p = motion(direction[i])
    total = own_block[i] * p
    own = direction[i][3]
    for slot in range(pairs.first[i], pairs.first[i] + pairs.acting[i]):
        j = pairs.other[slot]
        n = pair_direction(pairs, slot)
        closing = wp.dot(n, p - motion(direction[j]))
        pressures = own + direction[j][3]
        total += n * tangent_pull(
            shared, pairs.stiffness[slot], closing, pairs.slope[slot], pressures
        )
    product[i] = total
    wp.atomic_add(curvature, awake.part, iteration, wp.float64(wp.dot(total, p)))
