# SPDX-License-Identifier: GPL-3.0-or-later
"""Forces of pairs with their tangent, and the flow of bonds at the end of a substep."""

import warp as wp

from ...core.awake import Awake, awake_particle
from ..law_data import PairLaw, ParticleLaw, SharedLaw
from ..law_functions import (
    bond_breaks,
    bond_hold,
    flow_bond,
    kernel_slope,
    pair_pull,
    pair_tangent,
    pressure_tangent,
)
from .rows import COMPRESSION, DAMPING, DILATION, SHARE, PairRows, pair_direction


@wp.kernel(enable_backward=False)
def sum_forces(
    awake: Awake,
    shared: SharedLaw,
    pair_laws: wp.array[PairLaw],
    particle_laws: wp.array[ParticleLaw],
    material: wp.array[int],
    velocity_free: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
    residual: wp.array[wp.vec3],
    diagonal: wp.array[wp.mat33],
) -> None:
    """Find the residual impulse of each particle [N s], and the tangent of the forces [kg]."""
    i = awake_particle(awake, wp.tid())
    if i < 0:
        return
    material_row = material[i] * shared.material_count
    own = particle_laws[material[i]]
    condition = pairs.condition[i]
    compression = condition[COMPRESSION]
    pressure = own.pressure_stiffness * compression
    force = wp.vec3()
    slope_sum = wp.vec3()
    block = wp.identity(n=3, dtype=float) * own.mass
    for slot in range(pairs.first[i], pairs.first[i] + pairs.acting[i]):
        j = pairs.other[slot]
        apart = pairs.distance_next[slot]
        n = pair_direction(pairs, slot)
        slope = kernel_slope(shared, apart)
        mean = 0.5 * (condition + pairs.condition[j])
        other_compression = pairs.condition[j][COMPRESSION]
        other_stiffness = particle_laws[material[j]].pressure_stiffness
        rest = pairs.rest_length[slot]
        stiffness = float(0.0)
        stretch = float(0.0)
        softening = float(0.0)
        if rest > 0.0:
            law = pair_laws[material_row + material[j]]
            tension = law.tension_stretch
            pressed = mean[COMPRESSION] > 0.0
            bond = flow_bond(shared, tension, rest, apart, mean[DILATION], mean[SHARE], pressed)
            stiffness = law.stiffness * bond_hold(shared, rest)
            stretch = apart - bond[0]
            softening = bond[1]
        pressures = pressure + other_stiffness * other_compression
        parted = apart - pairs.distance[slot]
        pull = pair_pull(shared, mean[DAMPING], parted, pressures, slope, stiffness, stretch)
        force += n * pull
        tangent = pair_tangent(shared, stiffness, softening, mean[DAMPING])
        pairs.stiffness[slot] = tangent
        pairs.slope[slot] = slope
        slope_sum += n * slope
        weight = tangent
        if other_compression > 0.0:
            weight += pressure_tangent(shared, other_stiffness) * slope * slope
        block += wp.outer(n, n) * weight
    if compression > 0.0:
        own_tangent = pressure_tangent(shared, own.pressure_stiffness)
        block += wp.outer(slope_sum, slope_sum) * own_tangent
    residual[i] = (velocity_free[i] - velocity[i]) * own.mass + force * shared.time_step
    diagonal[i] = block


@wp.kernel(enable_backward=False)
def flow_pairs(
    awake: Awake,
    shared: SharedLaw,
    pair_laws: wp.array[PairLaw],
    material: wp.array[int],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
) -> None:
    """Write the bonds' rest lengths after flow, and release those that broke.

    Lengths are those at the final velocities; volume and stress are those of the last
    linearization.
    """
    i = awake_particle(awake, wp.tid())
    if i < 0:
        return
    for slot in range(pairs.first[i], pairs.first[i] + pairs.acting[i]):
        rest = pairs.rest_length[slot]
        if rest > 0.0:
            j = pairs.other[slot]
            law = pair_laws[material[i] * shared.material_count + material[j]]
            mean = 0.5 * (pairs.condition[i] + pairs.condition[j])
            tension = law.tension_stretch
            pressed = mean[COMPRESSION] > 0.0
            closing = velocity[j] - velocity[i]
            offset = pair_direction(pairs, slot) * pairs.distance[slot] + closing * shared.time_step
            apart = wp.length(offset)
            bond = flow_bond(shared, tension, rest, apart, mean[DILATION], mean[SHARE], pressed)
            pairs.rest_length[slot] = wp.where(bond_breaks(shared, apart, bond[0]), 0.0, bond[0])
