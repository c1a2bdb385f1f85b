# SPDX-License-Identifier: GPL-3.0-or-later
"""Cutting: a bond breaks across a collider that is thinner than the bond is long.

A blade pushes the clay on both sides away, but bonds reach across a thin blade and hold. So a bond
breaks if both of its ends touch the same mesh and each lies behind the surface that the other
touches.
"""

import warp as wp

from ..colliders.contacts import Contacts
from ..contact.law import ContactSlots
from ..contact.passes_cpu import Near
from ..core.awake import Awake, awake_particle
from ..core.vector_units import BLOCK
from .pairs.rows import PairRows

MIN_COSINE_BEHIND = 0.5
"""A bond's other end lies behind a surface if the cosine between the direction to it and the
direction into the surface is more than this."""


@wp.func
def cut_bonds_of(
    plane_count: int, position: wp.array[wp.vec3], slots: ContactSlots, pairs: PairRows, i: int
) -> None:
    """Break a particle's bonds to the far side of meshes that it touches."""
    for k in range(slots.count[i]):
        if slots.collider[i, k] >= plane_count:
            for slot in range(pairs.first[i], pairs.first[i] + pairs.acting[i]):
                j = pairs.other[slot]
                if pairs.rest_length[slot] > 0.0 and slots.count[j] > 0:
                    direction = wp.normalize(position[j] - position[i])
                    if wp.dot(direction, slots.normal[i, k]) < -MIN_COSINE_BEHIND:
                        for other in range(slots.count[j]):
                            if (
                                slots.collider[j, other] == slots.collider[i, k]
                                and wp.dot(direction, slots.normal[j, other]) > MIN_COSINE_BEHIND
                            ):
                                pairs.rest_length[slot] = 0.0


@wp.kernel(enable_backward=False)
def cut_bonds(
    awake: Awake,
    plane_count: int,
    position: wp.array[wp.vec3],
    slots: ContactSlots,
    pairs: PairRows,
) -> None:
    """Apply `cut_bonds_of` to each particle."""
    i = awake_particle(awake, wp.tid())
    if i >= 0:
        cut_bonds_of(plane_count, position, slots, pairs, i)


@wp.kernel(enable_backward=False)
def cut_bonds_of_block(
    awake: Awake,
    plane_count: int,
    position: wp.array[wp.vec3],
    slots: ContactSlots,
    pairs: PairRows,
    near: Near,
) -> None:
    """Apply `cut_bonds_of` to the particles of a block that are near something."""
    block = wp.tid()
    for k in range(near.count[block]):
        cut_bonds_of(plane_count, position, slots, pairs, near.index[block * BLOCK + k])


def cut_all_bonds(contacts: Contacts, pairs: PairRows) -> None:
    """Break bonds across meshes thinner than they are long, once contacts have been found."""
    if contacts.meshes:
        contacts.launch(
            (cut_bonds, cut_bonds_of_block),
            contacts.plane_count,
            contacts.particles.position,
            contacts.slots,
            pairs,
        )
