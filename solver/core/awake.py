# SPDX-License-Identifier: GPL-3.0-or-later
"""The awake particles, as kernels see them."""

import warp as wp


@wp.struct
class Awake:
    """The particles that passes work on."""

    count: wp.array[int]
    """How many; on the device, so that recorded passes can be replayed when it changes."""
    index: wp.array[int]
    part: int
    """Index of this part of the particles: each CPU thread works on one and has its own sums."""


@wp.func
def awake_particle(awake: Awake, thread: int) -> int:
    """The particle of a thread, or -1 if more threads run than are needed."""
    if thread >= awake.count[0]:
        return -1
    return awake.index[thread]
