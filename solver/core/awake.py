# SPDX-License-Identifier: GPL-3.0-or-later
"""Which particles passes work on."""

import warp as wp


@wp.struct
class Awake:
    """The particles that passes work on."""

    count: wp.array[int]
    """How many; on the device, so that recorded passes can be replayed when it changes."""
    index: wp.array[int]
    part: int
    """Which part of the particles this is: each thread of a CPU works on one, and sums of its own
    are kept for each."""


@wp.func
def awake_particle(awake: Awake, thread: int) -> int:
    """The particle that a thread works on, or -1: more threads may run than are needed."""
    if thread >= awake.count[0]:
        return -1
    return awake.index[thread]
