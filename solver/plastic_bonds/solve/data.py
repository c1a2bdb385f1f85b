# SPDX-License-Identifier: GPL-3.0-or-later
"""Work arrays shared by the passes of conjugate gradients."""

import warp as wp


@wp.struct
class Solve:
    """Work arrays of a solve."""

    residual: wp.array[wp.vec3]
    """Residual impulse [N s]."""
    inverse: wp.array[wp.mat33]
    """Inverse of each particle's diagonal block [1/kg]."""
    z: wp.array[wp.vec3]
    """The residual preconditioned by blocks [m/s]."""
    direction: wp.array[wp.vec4]
    """Search direction [m/s], and its change of a compressed particle's pressure [kg m²/s]."""
    product: wp.array[wp.vec3]
    """Search direction times tangent [N s]."""
    change: wp.array[wp.vec3]
    """Velocity changes of the solve [m/s]."""
    size: wp.array2d[wp.float64]
    """Preconditioned square of the residual by part and iteration [J], without its coarse part."""
    curvature: wp.array2d[wp.float64]
    """Energy of the direction by part and iteration [J]."""
    position: wp.array[wp.vec3]
    cell: wp.array[int]
    """Coarse cell of each particle."""
    center: wp.array[wp.vec3]
    """Center of each coarse cell [m]."""
    sums: wp.array2d[wp.float64]
    """The residual restricted to the coarse modes, by part."""
    modes: wp.array2d[float]
    """Motions of the coarse cells; each part has its own copy."""
    coarse_size: wp.array2d[wp.float64]
    """The coarse part of the residual's square by iteration [J]; each part has its own copy."""
