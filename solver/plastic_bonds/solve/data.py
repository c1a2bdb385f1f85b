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
    direction: wp.array[wp.vec4]
    """Direction of search [m/s], and by how much it changes a compressed particle's pressure
    [kg m/s]."""
    product: wp.array[wp.vec3]
    change: wp.array[wp.vec3]
    """What the solve changes of the velocities [m/s]."""
    size: wp.array2d[wp.float64]
    """Preconditioned square of the residual by part and iteration [J], without its coarse part."""
    curvature: wp.array2d[wp.float64]
    """Energy of the direction by part and iteration [J]."""
    position: wp.array[wp.vec3]
    cell: wp.array[int]
    center: wp.array[wp.vec3]
    sums: wp.array2d[wp.float64]
    """The residual restricted to the coarse modes, by part."""
    modes: wp.array2d[float]
    """Motions of the coarse cells; each part has its own copy."""
    coarse_size: wp.array2d[wp.float64]
    """The coarse part of the residual's square by iteration [J]; each part has its own copy."""
