# SPDX-License-Identifier: GPL-3.0-or-later
"""The smoothing kernel of the paper's clay (eq. 1): a cubic spline with a support of two spacings.

Monaghan, *Smoothed Particle Hydrodynamics*, Annual Review of Astronomy and Astrophysics 30, 1992,
doi 10.1146/annurev.aa.30.090192.002551. With this support its sum over a cubic lattice is one, so
that clay on a lattice is neither compressed nor stretched.
"""

import warp as wp

KERNEL_RADIUS = 2.0
"""Support of the kernel, in spacings."""


@wp.func
def cubic_kernel(distance: float, radius: float) -> float:
    """Cubic spline W [1/m³] with support ``radius``."""
    q = distance / radius
    scale = 8.0 / (wp.PI * radius * radius * radius)
    if q <= 0.5:
        return scale * (6.0 * (q - 1.0) * q * q + 1.0)
    if q < 1.0:
        return scale * 2.0 * (1.0 - q) * (1.0 - q) * (1.0 - q)
    return 0.0


@wp.func
def cubic_gradient(offset: wp.vec3, radius: float) -> wp.vec3:
    """Gradient of W(x_i - x_j) with respect to x_i [1/m⁴], for ``offset`` = x_j - x_i [m]."""
    distance = wp.length(offset)
    q = distance / radius
    if q >= 1.0 or distance < 1.0e-9 * radius:
        return wp.vec3()
    scale = 48.0 / (wp.PI * radius * radius * radius * radius)
    slope = (2.0 - 3.0 * q) * q
    if q > 0.5:
        slope = (1.0 - q) * (1.0 - q)
    return offset * (scale * slope / distance)
