# SPDX-License-Identifier: GPL-3.0-or-later
"""What the passes of conjugate gradients share."""

import warp as wp


@wp.struct
class Solve:
    """What the passes share."""

    residual: wp.array[wp.vec3]
    """Impulse still missing [N s]."""
    inverse: wp.array[wp.mat33]
    """Of each particle's own block [1/kg]."""
    z: wp.array[wp.vec3]
    """The residual preconditioned by blocks [m/s]."""
    direction: wp.array[wp.vec3]
    product: wp.array[wp.vec3]
    change: wp.array[wp.vec3]
    """What the solve changes of the velocities [m/s]."""
    size: wp.array[wp.float64]
    """Preconditioned square of the residual by iteration [J], its coarse part left out."""
    curvature: wp.array[wp.float64]
    """Energy of the direction by iteration [J]."""
    position: wp.array[wp.vec3]
    cell: wp.array[int]
    center: wp.array[wp.vec3]
    sums: wp.array[wp.float64]
    """The residual restricted to the coarse modes."""
    modes: wp.array[float]
    """Motions of the coarse cells."""
    coarse_size: wp.array[wp.float64]
    """The coarse part of the residual's square by iteration [J]."""
