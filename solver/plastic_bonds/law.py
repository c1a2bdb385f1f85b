# SPDX-License-Identifier: GPL-3.0-or-later
"""The constitutive law of the clay: how bonds yield and flow, and the pressure of compressed clay.

After the semi-permanent distance constraints of Barreiro, Torres and Otaduy, *Natural Tactile
Interaction with Virtual Clay*, WHC 2021 (eq. 5), with these differences: a bond is a spring of
physical stiffness instead of a rigid constraint; it yields by stress instead of by a rate of
separation, so that slow hands can shape it too.

Flow is decided by particle: its bonds define a stress, and if the shear part of that (von Mises)
exceeds the yield stress, the stretch of all its bonds relaxes by one fraction (radial return; Simo
and Hughes, *Computational Inelasticity*, 1998, section 3.3), such that the yield stress is left. So
the yield stress applies to shear in any direction, whatever the bonds' arrangement, and nothing is
fitted.

Viscosity acts in parallel with the bonds, between all pairs, on the rate at which they separate or
approach; it replaces the strain-rate constraint (eqs. 3 and 4). It must not act on the flow of
bonds: clay that flows far also breaks bonds and forms new ones, and material that flows in that way
would feel none. A network of dampers c on lines of length l, evenly distributed over all
directions, has the shear viscosity Σ c l² / 30 V (the same sum as for the modulus of a network of
springs), and each particle's c follows from that.

Each formula is written once, in `FORMULAS`, for numbers that are floats or lanes of floats. The
passes for the CPU's vector units (`measures_cpu`, `forces_cpu` and `products_cpu` in `pairs`)
include that text and apply it to eight pairs at a time; `law_functions` wraps each formula in a
Warp function of one pair for the plain kernels, which also run on GPUs. The text expects a
`law_data.SharedLaw` named ``shared`` in scope; ``own`` is a `law_data.ParticleLaw`. Arguments and
units are documented at the Warp functions.
"""

FORGETTING = 20.0
"""When bonds lose a fraction of their stretch by flow, they lose this many times that fraction of
their volume change: the pressure keeps the volume, and bonds that did so too would resist shear."""
MIN_SOFTENING = 0.05
"""Smallest secant stiffness of a flowing bond, relative to the elastic one."""
MIN_SQUARES = 24.0
"""Smallest sum of squared pair lengths over d² by which viscosity is divided; inside the clay the
sum is 25 to 30. A particle with few neighbors is then no stiffer than a thread of clay."""
DAMPING_OF_VISCOSITY = 26.0
"""Sum of c l² over viscosity and volume: 30 for pairs evenly distributed over all directions. In
flowing clay their arrangement resists 1.15 times as much (measured)."""
MIN_STRAIN_RATE = 0.01
"""Shear-thinning clay thickens no further below this strain rate [1/s]."""
COINCIDENT = 1e-6
"""Particles closer than this count as coincident, in spacings."""
MIN_LENGTHS = 1e-12
"""Smallest sum of squared rest lengths, over d²; keeps the dilation of a particle without bonds
finite."""

_CONSTANTS = "".join(
    f"    const float {name} = {value!r}f;\n"
    for name, value in {
        "FORGETTING": FORGETTING,
        "MIN_SOFTENING": MIN_SOFTENING,
        "MIN_SQUARES": MIN_SQUARES,
        "DAMPING_OF_VISCOSITY": DAMPING_OF_VISCOSITY,
        "MIN_STRAIN_RATE": MIN_STRAIN_RATE,
        "COINCIDENT": COINCIDENT,
        "MIN_LENGTHS": MIN_LENGTHS,
    }.items()
)

FORMULAS = (
    _CONSTANTS
    + """
    const float dt = shared.time_step, dt_squared = dt * dt, per_step = 1.f / dt;
    const float area = shared.spacing * shared.spacing;
    const float inverse_radius = 1.f / shared.kernel_radius;
    const float slope_scale = 3.f * shared.inverse_rest_sum * inverse_radius;
    const float coincident = COINCIDENT * shared.spacing;

    // Which pairs act -----------------------------------------------------------------------------

    // Whether a listed pair, at a squared distance, begins to press.
    auto begins_to_press = [&](auto square) ALWAYS_INLINE {
        return square < shared.press_reach * shared.press_reach;
    };
    // Whether a free pair is close enough to bond.
    auto forms_bond = [&](auto apart) ALWAYS_INLINE { return apart < shared.form_reach; };
    // Whether a free pair no longer presses.
    auto lets_go = [&](auto apart) ALWAYS_INLINE { return apart >= shared.break_length; };
    // Whether a bond breaks, at its current length and its rest length after flow.
    auto bond_breaks = [&](auto apart, auto rest) ALWAYS_INLINE {
        return maximum(apart, rest) > shared.break_length;
    };

    // Density and pressure ------------------------------------------------------------------------

    // (1 - r/h)³: a neighbor's contribution to the density, before division by the sum at rest.
    auto kernel_value = [&](auto apart) ALWAYS_INLINE {
        const auto t = maximum(1.f - apart * inverse_radius, 0.f);
        return t * t * t;
    };
    // How fast a neighbor's contribution to the relative density falls with distance [1/m].
    auto kernel_slope = [&](auto apart) ALWAYS_INLINE {
        const auto t = maximum(1.f - apart * inverse_radius, 0.f);
        return t * t * slope_scale;
    };
    // Relative excess over the rest density, at least 0; from the sum of the neighbors' kernel
    // values and the length of the sum of these times the directions to them. A particle at a
    // surface is credited with neighbors that it lacks: otherwise clay would be compressed there
    // until the others made up for them.
    auto compression_of = [&](float neighbors, float lopsided) ALWAYS_INLINE {
        const float beyond = lopsided * shared.inverse_rest_sum - shared.surface_floor;
        const float surface = maximum(shared.surface_gain * beyond, 0.f);
        return maximum((1.f + neighbors) * shared.inverse_rest_sum - 1.f + surface, 0.f);
    };
    // Derivative of a particle's pressure with respect to its density, times dt² [kg m²].
    auto pressure_tangent = [&](auto pressure_stiffness) ALWAYS_INLINE {
        return pressure_stiffness * dt_squared;
    };

    // Stress and flow -----------------------------------------------------------------------------

    // Fraction of its stiffness that a bond retains at its rest length [m]: long ones fade.
    auto bond_hold = [&](auto rest) ALWAYS_INLINE {
        return minimum(maximum((shared.break_length - rest) * shared.inverse_fade, 0.f), 1.f);
    };
    // A bond's term in a particle's sum of stretch times length [m²], to be multiplied by the dyad
    // of the bond's direction.
    auto bond_stretch = [&](auto hold, auto rest, auto apart) ALWAYS_INLINE {
        return hold * ((apart - rest) * apart);
    };
    // Mean linear strain of a particle's bonds, from the trace of that sum and the sum of their
    // squared rest lengths times hold [m²].
    auto dilation_of = [&](float trace, float lengths) ALWAYS_INLINE {
        return trace / maximum(lengths, MIN_LENGTHS * area);
    };
    // The yield law: the fraction of their stretch that a particle's bonds lose in one substep.
    auto flow_share = [&](const auto& own, float xx, float yy, float zz, float xy, float xz,
                          float yz) ALWAYS_INLINE {
        const float mean = (xx + yy + zz) * (1.f / 3.f);
        const float dx = xx - mean, dy = yy - mean, dz = zz - mean;
        const float norm = 0.5f * (dx * dx + dy * dy + dz * dz) + xy * xy + xz * xz + yz * yz;
        // Each bond belongs to two particles; its stiffness is the shear modulus times the spacing.
        const float stress = 0.5f * own.shear_modulus / area * root(norm);
        return stress > own.yield_stress ? 1.f - own.yield_stress / stress : 0.f;
    };
    // The rest length of a bond after one substep of flow. Its softening is the secant stiffness
    // over the elastic one: 1 where nothing flowed; more than the secant where a bond both yields
    // and draws out. (The consistent tangent of a yielding bond is near zero and makes Newton's
    // method diverge; the secant through the origin is safe.)
    auto flow_bond = [&](auto tension_stretch, auto rest, auto apart, auto dilation, auto share,
                         auto pressed, auto& softening) ALWAYS_INLINE {
        const auto stretch = apart - rest;
        const auto volume_stretch = dilation * rest;
        auto flow = share * (stretch - volume_stretch);
        const auto forgets = (volume_stretch < 0.f) | pressed;
        flow += select(forgets, volume_stretch * minimum(share * FORGETTING, 1.f), 0.f);
        const auto over = stretch - flow - tension_stretch;
        const auto draws = over > 0.f;
        flow += select(draws, over, 0.f);
        softening = 1.f - share;
        const auto drawn = 1.f - over / select(draws, stretch, 1.f);
        softening = select(draws, minimum(softening, drawn), softening);
        softening = maximum(softening, MIN_SOFTENING);
        return maximum(rest + flow, shared.min_rest_length);
    };

    // Forces and their tangent --------------------------------------------------------------------

    // A particle's damping of its pairs [N s/m], from its viscosity at the current strain rate, and
    // from sums over its pairs: squared length [m²], length times separation speed [m²/s] and
    // squared separation speed [m²/s²].
    auto pair_damping = [&](const auto& own, float squares, float parting, float rates)
        ALWAYS_INLINE {
        const float lengths = maximum(squares, MIN_SQUARES * area);
        float viscosity = own.consistency;
        if (own.flow_index != 1.f) {
            // Over pairs of all directions, separation rates have a mean square of 2/15 of D : D.
            const float mean = parting / lengths;
            const float rate = 15.f * (rates / lengths - mean * mean);
            viscosity *= power(maximum(rate, MIN_STRAIN_RATE * MIN_STRAIN_RATE),
                0.5f * (own.flow_index - 1.f));
        }
        const float damping = DAMPING_OF_VISCOSITY * area * shared.spacing * viscosity / lengths;
        return minimum(damping, own.mass * shared.max_damping);
    };
    // Force that pulls the ends of a pair together [N]: from viscosity, by how far they separate in
    // the substep; from the pressures of both; and from the stretch of the bond.
    auto pair_pull = [&](auto damping, auto parted, auto pressures, auto slope, auto stiffness,
                         auto stretch) ALWAYS_INLINE {
        auto pull = damping * parted * per_step;
        pull -= pressures * slope;
        pull += stiffness * stretch;
        return pull;
    };
    // Derivative of bond and viscosity, times dt² [kg].
    auto pair_tangent = [&](auto stiffness, auto softening, auto damping) ALWAYS_INLINE {
        return damping * dt + stiffness * softening * dt_squared;
    };
    // Response of the tangent to a motion of the ends [kg m/s], from the speed at which they
    // approach [m/s] and the changes of both pressures.
    auto tangent_pull = [&](auto tangent, auto closing, auto slope, auto pressures) ALWAYS_INLINE {
        return tangent * closing + slope * pressures;
    };
"""
)
