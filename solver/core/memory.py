# SPDX-License-Identifier: GPL-3.0-or-later
"""Device memory held by the parts of a solver."""

import warp as wp


def bytes_held(part: object, seen: set[int]) -> int:
    """Size of all device arrays reachable from an object, except those already seen [bytes]."""
    if id(part) in seen:
        return 0
    seen.add(id(part))
    if isinstance(part, wp.array):
        return int(part.capacity)
    if isinstance(part, list | tuple):
        return sum(bytes_held(item, seen) for item in part)
    ours = type(part).__module__.startswith(__name__.removesuffix(".core.memory"))
    # Most arrays are in the structs that kernels take.
    if ours or hasattr(part, "_ctype"):
        return sum(bytes_held(item, seen) for item in vars(part).values())
    return 0
