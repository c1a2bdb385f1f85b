# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows of neighbors, which hold the pairs that act in a substep.

Each particle keeps a row of neighbors; the rows lie end to end in arrays as long as needed. The
first slots of a row act: bonds, and free pairs close enough to press. A slot holds the neighbor's
index and the pair's rest length: positive for a bond, 0 for a free pair, negative for one that
presses, where it counts the substeps until it bonds. Every pair is kept at both ends, so that each
particle gathers its own sum and no pass needs atomics. Both ends compute the same numbers from the
same values, so forces are equal and opposite and rest lengths stay equal, up to rounding. A pair's
direction is taken at the start of the substep and its length at the end, so pair forces conserve
angular momentum exactly.
"""

import warp as wp

from ..law_data import SharedLaw
from ..law_functions import begins_to_press, forms_bond, lets_go

COMPRESSION = wp.constant(0)
DILATION = wp.constant(1)
SHARE = wp.constant(2)
DAMPING = wp.constant(3)
MAX_SLOTS = 96
"""Largest number of neighbors of a particle: clay at three times its density, in two spacings."""

ROW = """
    const int acting = pairs.acting.data[i];
    const int end = (acting + 7) & ~7;
    const long long row = pairs.first.data[i];
    const int* __restrict__ other = pairs.other.data + row;
    float* __restrict__ rests = pairs.rest_length.data + row;
    float* __restrict__ nx = pairs.direction_x.data + row;
    float* __restrict__ ny = pairs.direction_y.data + row;
    float* __restrict__ nz = pairs.direction_z.data + row;
    float* __restrict__ distance = pairs.distance.data + row;
    float* __restrict__ next = pairs.distance_next.data + row;
    float* __restrict__ stiffness = pairs.stiffness.data + row;
    float* __restrict__ slope = pairs.slope.data + row;
"""
"""Native code that finds the row of particle ``i``, for vector units."""


@wp.struct
class PairRows:
    """The rows of all particles."""

    first: wp.array[int]
    """First slot of a particle's row: a multiple of eight."""
    room: wp.array[int]
    """Number of slots of a row: a multiple of eight."""
    listed: wp.array[int]
    """Number of slots in use."""
    acting: wp.array[int]
    """Number of slots that act, from the first."""
    resting: wp.array[int]
    """1 for a sleeping particle, which forms no bonds."""
    other: wp.array[int]
    """Index of the neighbor."""
    rest_length: wp.array[float]
    """Rest length of a bond [m]; 0 or negative for a free pair."""
    direction_x: wp.array[float]
    direction_y: wp.array[float]
    direction_z: wp.array[float]
    """Unit vector toward the neighbor at the start of the substep; by axis for vector units."""
    distance: wp.array[float]
    """Length at the start of the substep [m]."""
    distance_next: wp.array[float]
    """Length at the end of the substep [m]."""
    stiffness: wp.array[float]
    """Tangent of bond and damping [kg]: force derivative times Δt²."""
    slope: wp.array[float]
    """How fast the pair's contribution to the density falls with distance [1/m]."""
    condition: wp.array[wp.vec4]
    """What neighbors need to know of a particle, packed for vector units: at `COMPRESSION` its
    relative excess over the rest density, at least 0; at `DILATION` the mean linear strain of its
    bonds; at `SHARE` the fraction of their stretch that its bonds lose by flow in the substep; at
    `DAMPING` its damping of pairs [N s/m]."""


@wp.func
def pair_direction(pairs: PairRows, slot: int) -> wp.vec3:
    """Unit vector from a particle to the other end of a pair."""
    return wp.vec3(pairs.direction_x[slot], pairs.direction_y[slot], pairs.direction_z[slot])


@wp.func
def swap_slots(pairs: PairRows, a: int, b: int) -> None:
    """Exchange two neighbors of a row."""
    other = pairs.other[a]
    rest = pairs.rest_length[a]
    pairs.other[a] = pairs.other[b]
    pairs.rest_length[a] = pairs.rest_length[b]
    pairs.other[b] = other
    pairs.rest_length[b] = rest


@wp.func
def keep_bonds(pairs: PairRows, i: int) -> int:
    """Pack a row's bonds to its front and return how many there are."""
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
    """Drop pairs that no longer act, add those that come close, and form new bonds."""
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
