# SPDX-License-Identifier: GPL-3.0-or-later
"""Cutting: bonds across a collider thinner than they are long give way to it.

A blade pushes the clay on both of its sides away, but bonds reach over a thin one and hold on. So a
bond breaks where both of its ends touch the same mesh and each lies behind the surface that the
other touches.
"""

import warp as wp

from ..contact.contacts import Contacts
from ..contact.contacts_cpu import Near
from ..contact.law import ContactSlots
from ..core.awake import Awake, awake_particle
from ..core.vector_units import BLOCK
from .pairs.rows import PairRows

BEHIND = 0.5
"""Least cosine between the way to the other end and the way into the surface."""


@wp.func
def cut_bonds_of(
    plane_count: int, position: wp.array[wp.vec3], slots: ContactSlots, pairs: PairRows, i: int
) -> None:
    """Break a particle's bonds to the other side of what it touches; planes have none."""
    for k in range(slots.count[i]):
        if slots.collider[i, k] >= plane_count:
            for slot in range(pairs.first[i], pairs.first[i] + pairs.acting[i]):
                j = pairs.other[slot]
                if pairs.rest_length[slot] > 0.0 and slots.count[j] > 0:
                    way = wp.normalize(position[j] - position[i])
                    if wp.dot(way, slots.normal[i, k]) < -BEHIND:
                        for other in range(slots.count[j]):
                            if (
                                slots.collider[j, other] == slots.collider[i, k]
                                and wp.dot(way, slots.normal[j, other]) > BEHIND
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
    """`cut_bonds_of` each particle."""
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
    """`cut_bonds_of` the particles of a block that are near something."""
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
