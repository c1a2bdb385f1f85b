# SPDX-License-Identifier: GPL-3.0-or-later
"""The law's formulas as Warp functions of one pair or particle, for the plain kernels.

The formulas themselves are in `law`.
"""

import warp as wp

from ..core.vector_units import NUMBERS
from .law import FORMULAS
from .law_data import ParticleLaw, SharedLaw


def _plain(statement: str) -> str:
    """Source of a native function that calls a formula with single numbers."""
    return f"{{{NUMBERS}{FORMULAS}{statement}}}"


@wp.func_native(_plain("return coincident;"))
def coincident_distance(shared: SharedLaw) -> float:  # type: ignore[empty-body]
    """Distance up to which particles coincide [m]."""


@wp.func_native(_plain("return begins_to_press(square);"))
def begins_to_press(shared: SharedLaw, square: float) -> bool:  # type: ignore[empty-body]
    """Whether a listed pair, at a squared distance [m²], begins to press."""


@wp.func_native(_plain("return forms_bond(apart);"))
def forms_bond(shared: SharedLaw, apart: float) -> bool:  # type: ignore[empty-body]
    """Whether a free pair at a distance [m] is close enough to bond."""


@wp.func_native(_plain("return lets_go(apart);"))
def lets_go(shared: SharedLaw, apart: float) -> bool:  # type: ignore[empty-body]
    """Whether a free pair at a distance [m] no longer presses."""


@wp.func_native(_plain("return bond_breaks(apart, rest);"))
def bond_breaks(shared: SharedLaw, apart: float, rest: float) -> bool:  # type: ignore[empty-body]
    """Whether a bond breaks, at its current length and rest length [m]."""


@wp.func_native(_plain("return kernel_value(apart);"))
def kernel_value(shared: SharedLaw, apart: float) -> float:  # type: ignore[empty-body]
    """A neighbor's contribution to the density, before division by the sum at rest."""


@wp.func_native(_plain("return kernel_slope(apart);"))
def kernel_slope(shared: SharedLaw, apart: float) -> float:  # type: ignore[empty-body]
    """How fast a neighbor's contribution to the relative density falls [1/m], positive."""


@wp.func_native(_plain("return compression_of(neighbors, lopsided);"))
def compression_of(  # type: ignore[empty-body]
    shared: SharedLaw, neighbors: float, lopsided: float
) -> float:
    """Relative excess over the rest density, at least 0.

    Args:
        shared: Values that all pairs share.
        neighbors: Sum of the neighbors' kernel values.
        lopsided: Length of the sum of these times their directions.
    """


@wp.func_native(_plain("return pressure_tangent(pressure_stiffness);"))
def pressure_tangent(  # type: ignore[empty-body]
    shared: SharedLaw, pressure_stiffness: float
) -> float:
    """Derivative of pressure with respect to density, times Δt² [kg m²]."""


@wp.func_native(_plain("return bond_hold(rest);"))
def bond_hold(shared: SharedLaw, rest: float) -> float:  # type: ignore[empty-body]
    """Fraction of its stiffness that a bond retains at its rest length [m]."""


@wp.func_native(_plain("return bond_stretch(hold, rest, apart);"))
def bond_stretch(  # type: ignore[empty-body]
    shared: SharedLaw, hold: float, rest: float, apart: float
) -> float:
    """A bond's term in a particle's sum of stretch times length [m²]."""


@wp.func_native(_plain("return dilation_of(trace, lengths);"))
def dilation_of(shared: SharedLaw, trace: float, lengths: float) -> float:  # type: ignore[empty-body]
    """Mean linear strain of a particle's bonds.

    Args:
        shared: Values that all pairs share.
        trace: Trace of the sum of stretch times length times the dyad of the direction [m²].
        lengths: Sum of hold times squared rest length [m²].
    """


@wp.func_native(
    _plain("""
    const auto& s = stretch.data;
    return flow_share(own, s[0][0], s[1][1], s[2][2], s[0][1], s[0][2], s[1][2]);
""")
)
def flow_share(  # type: ignore[empty-body]
    shared: SharedLaw, own: ParticleLaw, stretch: wp.mat33
) -> float:
    """The yield law: the fraction of their stretch that a particle's bonds lose in one substep.

    Args:
        shared: Values that all pairs share.
        own: The particle's values.
        stretch: Sum of stretch times length times the dyad of the direction [m²].
    """


@wp.func_native(
    _plain("""
    float softening;
    const float flowed =
        flow_bond(tension_stretch, rest, apart, dilation, share, pressed, softening);
    return wp::vec_t<2, float>(flowed, softening);
""")
)
def flow_bond(  # type: ignore[empty-body]
    shared: SharedLaw,
    tension_stretch: float,
    rest: float,
    apart: float,
    dilation: float,
    share: float,
    pressed: bool,
) -> wp.vec2:
    """The rest length of a bond after one substep of flow [m], and its softening.

    Softening is the secant stiffness over the elastic one: 1 where nothing flowed.

    Args:
        shared: Values that all pairs share.
        tension_stretch: Total stretch that the bond can carry in tension [m].
        rest: Rest length before [m].
        apart: Current distance [m].
        dilation: Mean linear strain of bonds at both ends: a volume change, which does not yield.
        share: Fraction of the stretch that flows, mean of both ends.
        pressed: Whether one of the ends is under pressure.
    """


@wp.func_native(_plain("return pair_damping(own, squares, parting, rates);"))
def pair_damping(  # type: ignore[empty-body]
    shared: SharedLaw, own: ParticleLaw, squares: float, parting: float, rates: float
) -> float:
    """A particle's damping of its pairs [N s/m], from its viscosity at the current strain rate.

    Args:
        shared: Values that all pairs share.
        own: The particle's values.
        squares: Sum of the pairs' squared lengths [m²].
        parting: Sum of length times separation speed [m²/s].
        rates: Sum of the squared separation speeds [m²/s²].
    """


@wp.func_native(_plain("return pair_pull(damping, parted, pressures, slope, stiffness, stretch);"))
def pair_pull(  # type: ignore[empty-body]
    shared: SharedLaw,
    damping: float,
    parted: float,
    pressures: float,
    slope: float,
    stiffness: float,
    stretch: float,
) -> float:
    """Force that pulls the ends of a pair together [N].

    Args:
        shared: Values that all pairs share.
        damping: Damping of the pair [N s/m].
        parted: How far the ends separate in the substep [m].
        pressures: Pressure stiffness times compression, sum of both ends [J].
        slope: Slope of the kernel [1/m].
        stiffness: Stiffness of the bond, 0 for a free pair [N/m].
        stretch: Length minus the rest length after flow [m].
    """


@wp.func_native(_plain("return pair_tangent(stiffness, softening, damping);"))
def pair_tangent(  # type: ignore[empty-body]
    shared: SharedLaw, stiffness: float, softening: float, damping: float
) -> float:
    """Derivative of bond and viscosity, times Δt² [kg]."""


@wp.func_native(_plain("return tangent_pull(tangent, closing, slope, pressures);"))
def tangent_pull(  # type: ignore[empty-body]
    shared: SharedLaw, tangent: float, closing: float, slope: float, pressures: float
) -> float:
    """Response of the tangent to a motion of a pair's ends [kg m/s].

    Args:
        shared: Values that all pairs share.
        tangent: `pair_tangent` [kg].
        closing: Speed at which the ends approach [m/s].
        slope: Slope of the kernel [1/m].
        pressures: Changes of the pressures of both ends [kg m²/s].
    """
