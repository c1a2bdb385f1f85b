# SPDX-License-Identifier: GPL-3.0-or-later
"""The grid box in which a point lies."""

import warp as wp


@wp.func
def box_of(position: wp.vec3, low: wp.vec3, inverse_edge: wp.vec3, counts: wp.vec3i) -> wp.vec3i:
    """Index of a point's box along each axis; points outside the grid belong to the outermost
    boxes.

    Rounding may put the lowest and highest points outside the grid that was laid over them.

    Args:
        position: The point [m].
        low: Corner of the first box [m].
        inverse_edge: One over the boxes' edges [1/m].
        counts: Boxes along each axis.
    """
    place = wp.cw_mul(position - low, inverse_edge)
    return wp.vec3i(
        int(wp.clamp(place[0], 0.0, float(counts[0] - 1))),
        int(wp.clamp(place[1], 0.0, float(counts[1] - 1))),
        int(wp.clamp(place[2], 0.0, float(counts[2] - 1))),
    )
