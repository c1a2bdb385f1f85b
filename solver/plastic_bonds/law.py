# SPDX-License-Identifier: GPL-3.0-or-later
"""The law of the clay: how a bond yields and flows, and what pressure answers compression.

After the semi-permanent distance constraints of Barreiro, Torres and Otaduy, *Natural Tactile
Interaction with Virtual Clay*, WHC 2021 (eq. 5), with these differences: a bond is a spring of
physical stiffness instead of a rigid constraint; it yields by stress instead of by a rate of
separation, so that slow hands can model it too.

Each particle decides how much flows: its bonds give it a stress, and where the shear of that (von
Mises) exceeds the yield stress, the stretch of all its bonds relaxes by one share (radial return;
Simo and Hughes, *Computational Inelasticity*, 1998, section 3.3), such that the yield stress is
left. So the yield stress is that of shear in any direction, whatever the bonds' arrangement, and
nothing is fitted.

Viscosity acts beside the bonds, between all pairs, on the rate at which they part or close: it
takes the place of the strain-rate constraint (eqs. 3 and 4). It must not act on the flow of bonds:
clay that flows far also breaks bonds and forms new ones, and material that flows in that way would
feel none. A network of dampers c on lines of length l that lie evenly in all directions has the
shear viscosity Σ c l² / 30 V (the same sum as for the modulus of a network of springs), and each
particle's c follows from that.

Each formula is written once, in `FORMULAS`, for numbers that are floats or lanes of floats. The
passes for the CPU's vector units (`measures_cpu`, `forces_cpu` and `products_cpu` in `pairs`)
include that text and apply it to eight pairs at a time; `law_functions` offers each formula as a
Warp function of one pair to the plain kernels, which also run on graphics cards. The text expects a
`law_data.SharedLaw` named ``shared`` in scope; ``own`` is a `law_data.ParticleLaw`. Arguments and
units are documented at the Warp functions.
"""

FORGETTING = 20.0
"""Where clay flows by a share, its bonds forget this many times the share of their change of
volume: the pressure keeps the volume, and bonds that did too would resist shear with it."""
MIN_SOFTENING = 0.05
"""Least secant stiffness of a flowing bond over the elastic one."""
MIN_SQUARES = 24.0
"""Least sum of squared pair lengths over d² that viscosity is shared by; inside the clay the sum is
25 to 30. Few neighbors do not make a particle stiffer than a thread of clay is."""
DAMPING_OF_VISCOSITY = 26.0
"""Sum of c l² over viscosity and volume: 30 where pairs lie evenly in all directions. In clay that
flows they lie so that they resist 1.15 times as much (measured)."""
MIN_STRAIN_RATE = 0.01
"""Clay that thins as it flows grows no thicker below this strain rate [1/s]."""
COINCIDENT = 1e-6
"""Particles closer than this have no direction from one to the other, in spacings."""
MIN_LENGTHS = 1e-12
"""Keeps the dilation of a particle without bonds finite: least sum of squared rest lengths, over
d²."""

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
    // Whether a bond breaks, at its present length and the rest length that it has flowed to.
    auto bond_breaks = [&](auto apart, auto rest) ALWAYS_INLINE {
        return most(apart, rest) > shared.break_length;
    };

    // Density and pressure ------------------------------------------------------------------------

    // (1 - r/h)³: a neighbor's share of the density, before it is divided by the sum at rest.
    auto kernel_value = [&](auto apart) ALWAYS_INLINE {
        const auto t = most(1.f - apart * inverse_radius, 0.f);
        return t * t * t;
    };
    // How fast a neighbor's share of the density over that at rest falls with distance [1/m].
    auto kernel_slope = [&](auto apart) ALWAYS_INLINE {
        const auto t = most(1.f - apart * inverse_radius, 0.f);
        return t * t * slope_scale;
    };
    // Density over that at rest, less one, where positive; from the sum of the neighbors' kernel
    // values and the length of the sum of these times the directions to them. A particle at a
    // surface is credited with neighbors that it lacks: otherwise clay would be pressed together
    // there until the others made up for them.
    auto compression_of = [&](float neighbors, float lopsided) ALWAYS_INLINE {
        const float beyond = lopsided * shared.inverse_rest_sum - shared.surface_floor;
        const float surface = most(shared.surface_gain * beyond, 0.f);
        return most((1.f + neighbors) * shared.inverse_rest_sum - 1.f + surface, 0.f);
    };
    // Derivative of a particle's pressure by its density, times dt² [kg m²].
    auto pressure_tangent = [&](auto pressure_stiffness) ALWAYS_INLINE {
        return pressure_stiffness * dt_squared;
    };

    // Stress and flow -----------------------------------------------------------------------------

    // How much of its stiffness a bond has, by its rest length [m]: long ones fade.
    auto bond_hold = [&](auto rest) ALWAYS_INLINE {
        return least(most((shared.break_length - rest) * shared.inverse_fade, 0.f), 1.f);
    };
    // A bond's term in a particle's sum of stretch times length [m²], to be multiplied by the dyad
    // of the bond's direction.
    auto bond_stretch = [&](auto hold, auto rest, auto apart) ALWAYS_INLINE {
        return hold * ((apart - rest) * apart);
    };
    // Mean linear strain of a particle's bonds, from the trace of that sum and the sum of their
    // squared rest lengths times hold [m²].
    auto dilation_of = [&](float trace, float lengths) ALWAYS_INLINE {
        return trace / most(lengths, MIN_LENGTHS * area);
    };
    // The yield law: fraction of their stretch that a particle's bonds lose in one substep.
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
    // and draws out. (The consistent tangent of a yielding bond is near zero and lets Newton's
    // method run away; the secant through the origin is safe.)
    auto flow_bond = [&](auto tension_stretch, auto rest, auto apart, auto dilation, auto share,
                         auto pressed, auto& softening) ALWAYS_INLINE {
        const auto stretch = apart - rest;
        const auto volume_stretch = dilation * rest;
        auto flow = share * (stretch - volume_stretch);
        const auto forgets = (volume_stretch < 0.f) | pressed;
        flow += select(forgets, volume_stretch * least(share * FORGETTING, 1.f), 0.f);
        const auto over = stretch - flow - tension_stretch;
        const auto draws = over > 0.f;
        flow += select(draws, over, 0.f);
        softening = 1.f - share;
        const auto drawn = 1.f - over / select(draws, stretch, 1.f);
        softening = select(draws, least(softening, drawn), softening);
        softening = most(softening, MIN_SOFTENING);
        return most(rest + flow, shared.min_rest_length);
    };

    // Forces and their tangent --------------------------------------------------------------------

    // A particle's damping of its pairs [N s/m], from its viscosity at the present strain rate: the
    // sums over its pairs of squared length [m²], of length times speed of parting [m²/s] and of
    // squared speed of parting [m²/s²].
    auto pair_damping = [&](const auto& own, float squares, float parting, float rates)
        ALWAYS_INLINE {
        const float lengths = most(squares, MIN_SQUARES * area);
        float viscosity = own.consistency;
        if (own.flow_index != 1.f) {
            // Pairs of all directions part at rates whose mean square is 2/15 of D : D.
            const float mean = parting / lengths;
            const float rate = 15.f * (rates / lengths - mean * mean);
            viscosity *= power(most(rate, MIN_STRAIN_RATE * MIN_STRAIN_RATE),
                0.5f * (own.flow_index - 1.f));
        }
        const float damping = DAMPING_OF_VISCOSITY * area * shared.spacing * viscosity / lengths;
        return least(damping, own.mass * shared.max_damping);
    };
    // Force that pulls the ends of a pair together [N]: from viscosity, by how far they part in the
    // substep; from the pressures of both; and from the stretch of the bond.
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
    // Response of the tangent to a motion of the ends [kg m/s], from the speed at which the motion
    // brings them together [m/s] and how it changes both pressures.
    auto tangent_pull = [&](auto tangent, auto closing, auto slope, auto pressures) ALWAYS_INLINE {
        return tangent * closing + slope * pressures;
    };
"""
)
