# SPDX-License-Identifier: GPL-3.0-or-later
"""The pairs that act in a substep, and the forces between them.

Each particle keeps a row of neighbours, one row behind the other in arrays as long as needed. The
first slots of a row act: bonds, and free pairs close enough to press. A slot holds the neighbour's
index and the pair's rest length: 0 for a free pair, negative while a new bond is being counted in,
positive for a bond. Every pair is kept at both ends, so that each particle gathers its own sum: no
pass needs atomics. Both ends compute the same numbers from the same values, so forces are equal and
opposite and rest lengths stay equal, but for rounding. A pair's direction is that at the start of
the substep, its length that at the end: so pair forces conserve angular momentum exactly.
"""

import warp as wp

from ...core.awake import Awake, awake_particle
from ..law_data import PairLaw, ParticleLaw, SharedLaw
from ..law_functions import (
    begins_to_press,
    bond_breaks,
    bond_hold,
    bond_stretch,
    coincident_distance,
    compression_of,
    dilation_of,
    flow_bond,
    flow_share,
    forms_bond,
    kernel_slope,
    kernel_value,
    lets_go,
    pair_damping,
    pair_pull,
    pair_tangent,
    pressure_tangent,
)

COMPRESSION = wp.constant(0)
DILATION = wp.constant(1)
SHARE = wp.constant(2)
DAMPING = wp.constant(3)
MAX_SLOTS = 96
"""Neighbours a particle can list: clay at three times its density within two spacings."""


@wp.struct
class PairRows:
    """The rows of all particles."""

    first: wp.array[int]
    """Where a particle's row begins: a multiple of eight."""
    room: wp.array[int]
    """Slots that belong to a row: a multiple of eight."""
    listed: wp.array[int]
    """Slots in use."""
    acting: wp.array[int]
    """Slots that act, from the first."""
    resting: wp.array[int]
    """1 for a particle that sleeps: it forms no bonds."""
    other: wp.array[int]
    rest_length: wp.array[float]
    """[m]; 0 for a free pair, negative while a bond is counted in."""
    direction_x: wp.array[float]
    direction_y: wp.array[float]
    direction_z: wp.array[float]
    """Towards the other, at the start of the substep; kept by axis for vector units."""
    distance: wp.array[float]
    """At the start of the substep [m]."""
    distance_next: wp.array[float]
    """At its end [m]."""
    stiffness: wp.array[float]
    """Tangent of bond and damping [kg]: force derivative times Δt²."""
    slope: wp.array[float]
    """How fast the pair's share of the density falls with distance [1/m]."""
    condition: wp.array[wp.vec4]
    """What the others must know of a particle, one behind the other for vector units: at
    `COMPRESSION` density over that at rest, less one, where positive; at `DILATION` the mean linear
    strain of its bonds; at `SHARE` the part of their stretch that its bonds lose by flow in the
    substep; at `DAMPING` its damping of the parting of pairs [N s/m]."""


@wp.func
def pair_direction(pairs: PairRows, slot: int) -> wp.vec3:
    """Unit vector from a particle to the other end of a pair."""
    return wp.vec3(pairs.direction_x[slot], pairs.direction_y[slot], pairs.direction_z[slot])


@wp.func
def swap_slots(pairs: PairRows, a: int, b: int) -> None:
    """Exchange two neighbours of a row."""
    other = pairs.other[a]
    rest = pairs.rest_length[a]
    pairs.other[a] = pairs.other[b]
    pairs.rest_length[a] = pairs.rest_length[b]
    pairs.other[b] = other
    pairs.rest_length[b] = rest


@wp.func
def keep_bonds(pairs: PairRows, i: int) -> int:
    """Pack a row's bonds to its front, and say how many they are."""
    first = pairs.first[i]
    used = first
    for slot in range(first, first + pairs.acting[i]):
        rest = pairs.rest_length[slot]
        if rest > 0.0:
            pairs.other[used] = pairs.other[slot]
            pairs.rest_length[used] = rest
            used += 1
    pairs.acting[i] = used - first
    return used - first


@wp.func
def sort_row(shared: SharedLaw, position: wp.array[wp.vec3], pairs: PairRows, i: int) -> None:
    """Let go of pairs that no longer act, take up those that come close, count new bonds in."""
    x = position[i]
    first = pairs.first[i]
    end = first + pairs.acting[i]
    slot = first
    while slot < end:
        rest = pairs.rest_length[slot]
        if rest <= 0.0:
            apart = wp.length(position[pairs.other[slot]] - x)
            if forms_bond(shared, apart):
                rest -= 1.0
                if rest < -shared.dwell:
                    rest = wp.max(apart, shared.min_rest_length)
            else:
                rest = wp.where(lets_go(shared, apart), 0.0, -1.0)
            pairs.rest_length[slot] = rest
        if rest == 0.0:
            end -= 1
            swap_slots(pairs, slot, end)
        else:
            slot += 1
    for candidate in range(end, first + pairs.listed[i]):
        j = pairs.other[candidate]
        if pairs.resting[j] == 0 and begins_to_press(shared, wp.length_sq(position[j] - x)):
            pairs.rest_length[candidate] = -1.0
            swap_slots(pairs, candidate, end)
            end += 1
    pairs.acting[i] = end - first


@wp.func
def lay_row(shared: SharedLaw, position: wp.array[wp.vec3], pairs: PairRows, i: int) -> None:
    """Find directions and distances of a particle's pairs."""
    floor = coincident_distance(shared)
    for slot in range(pairs.first[i], pairs.first[i] + pairs.acting[i]):
        j = pairs.other[slot]
        offset = position[j] - position[i]
        apart = wp.length(offset)
        direction = offset / wp.max(apart, floor)
        if apart <= floor:
            # Coincident particles part along a direction that both ends agree on.
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
    """Find the lengths of a particle's pairs at the end of the substep, its volume and stress."""
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
def lay_pairs(
    awake: Awake,
    shared: SharedLaw,
    particle_laws: wp.array[ParticleLaw],
    material: wp.array[int],
    position: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    pairs: PairRows,
) -> None:
    """Find the pairs that act, their directions and distances, and measure."""
    i = awake_particle(awake, wp.tid())
    if i >= 0:
        sort_row(shared, position, pairs, i)
        lay_row(shared, position, pairs, i)
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
    """Find each pair's length at the end of the substep, each particle's volume and stress."""
    i = awake_particle(awake, wp.tid())
    if i >= 0:
        measure_row(shared, particle_laws, material, velocity, pairs, i)


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
    """Impulse still missing at each particle [N s], and the tangent of the forces [kg]."""
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
    """Keep what flowed: write the bonds' new rest lengths, and drop those that broke.

    Lengths are those at the final velocities; volume and stress those last linearised at.
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
            way = pair_direction(pairs, slot) * pairs.distance[slot] + closing * shared.time_step
            apart = wp.length(way)
            bond = flow_bond(shared, tension, rest, apart, mean[DILATION], mean[SHARE], pressed)
            pairs.rest_length[slot] = wp.where(bond_breaks(shared, apart, bond[0]), 0.0, bond[0])
