# SPDX-License-Identifier: GPL-3.0-or-later
"""The law of the clay: how a bond yields and flows, and what pressure answers compression.

After the semi-permanent distance constraints of Barreiro, Torres and Otaduy, *Natural Tactile
Interaction with Virtual Clay*, WHC 2021 (eq. 5), with these differences: a bond is a spring of
physical stiffness instead of a rigid constraint; it yields by stress instead of by a rate of
separation, so that slow hands can model it too.

How much flows is decided by each particle: from its bonds it has a stress, and where the shear of
that (von Mises) is more than the yield stress, the stretch of all its bonds relaxes by one share
(radial return; Simo and Hughes, *Computational Inelasticity*, 1998, section 3.3), such that the
yield stress is left. So the yield stress is that of shear in any direction, whatever the bonds'
arrangement, and nothing is fitted.

Viscosity acts beside the bonds, between all pairs, on the rate at which they part or close: it
takes the place of the strain-rate constraint (eqs. 3 and 4). It must not act on the flow of bonds:
clay that flows far also breaks bonds and forms new ones, and what flows in that way would feel
none. A network of dampers c on lines of length l that lie evenly in all directions has the shear
viscosity Σ c l² / 30 V (the same sum as for the modulus of a network of springs), from which each
particle's c follows.
"""

import numpy as np
import warp as wp

from ..scene.material import Material
from ..scene.settings import Settings

KERNEL_RADIUS = 2.0
"""Reach of the density kernel, in spacings."""
BOND_REACH = 1.5
"""Pairs closer than this at the start are bonded, in spacings."""
FORM_REACH = 1.25
"""Free pairs closer than this become bonded, in spacings."""
PRESS_REACH = 1.4
"""Free pairs closer than this press on each other, in spacings, until they are as far apart as
bonds that break: pairs that came and went at one distance would jitter."""
SURFACE_FLOOR = 0.4
"""Lopsidedness that is taken for chance, over that of a flat surface."""
SURFACE_SHARE = 0.8
"""Part of the neighbours missing at a surface that is made up for. With all of them thin necks of
clay swell and part early; with none, kneaded clay loses a tenth of its volume."""
BREAK_LENGTH = 1.9
"""A bond longer than this is gone, in spacings."""
FADE_LENGTH = 1.5
"""A bond longer than this holds less and less, in spacings: one that broke under its full load
would take that from the clay at once."""
SHORTEST_LENGTH = 0.6
"""Rest lengths never fall below this, in spacings."""
DWELL = 2.0
"""Substeps a free pair must stay close before it bonds: a neighbour rushing by is not caught."""
TENSION = 1.0
"""Force at which a bond draws out over the tension limit times d²: more than bonds carry where the
clay shears at the same stress, so that it only bounds what all-round tension does."""
FORGETTING = 20.0
"""Where clay flows by a share, its bonds forget this many times the share of their change of
volume: the pressure keeps the volume, and bonds that did too would resist shear with it."""
SOFTEST = 0.05
"""The least secant stiffness of a flowing bond over the elastic one."""
LEAST_SQUARES = 24.0
"""Least sum of squared pair lengths over d² that viscosity is shared by; inside it is 25 to 30."""
DAMPING_OF_VISCOSITY = 26.0
"""Sum of c l² over viscosity and volume: 30 where pairs lie evenly in all directions; in clay that
flows they lie such that they resist 1.15 times as much (measured)."""
MOST_REACH = 64.0
"""Viscosity acts as if it were no higher than what carries motion this far in a substep, in
spacings: no more could be solved for."""
SLOWEST_RATE = 0.01
"""Strain rate below which clay that thins as it flows grows no thicker [1/s]."""
BULK_OVER_SHEAR = 3.0
"""Bulk modulus over shear modulus: clay hardly compresses."""


@wp.struct
class PairLaw:
    """How particles of two given materials act on each other."""

    stiffness: float
    """Bond stiffness [N/m]."""
    tension_stretch: float
    """Total stretch that a bond can carry in tension [m]."""


@wp.struct
class Body:
    """What a particle of a material has of its own."""

    mass: float
    """[kg]"""
    pressure_stiffness: float
    """Bulk modulus times particle volume [J]."""
    shear_modulus: float
    """[Pa]"""
    yield_stress: float
    """[Pa]"""
    consistency: float
    """Viscous stress at a strain rate of 1/s [Pa]."""
    flow_index: float
    """Power of the strain rate."""


@wp.struct
class Clay:
    """What all pairs share, for one time step."""

    spacing: float
    time_step: float
    kernel_radius: float
    inverse_rest_sum: float
    """1 over the sum of (1 - r/h)³ at rest."""
    surface_gain: float
    """What lopsidedness beyond the floor adds to a particle's density."""
    surface_floor: float
    """Lopsidedness of particles inside, which is by chance."""
    form_reach: float
    press_reach: float
    break_length: float
    inverse_fade: float
    """1 over the length on which bonds fade [1/m]."""
    shortest_length: float
    most_damping: float
    """Of a pair, over mass [1/s]."""
    dwell: float
    material_count: int
    bonds: int


@wp.struct
class BondFlow:
    """A bond after one substep of flow."""

    rest_length: float
    """[m]"""
    softening: float
    """Secant stiffness over the elastic one: 1 where nothing flowed."""


@wp.func
def flow_share(clay: Clay, body: Body, stretch: wp.mat33) -> float:
    """The yield law: part of their stretch that a particle's bonds lose in one substep.

    Args:
        clay: What all pairs share.
        body: The particle's values.
        stretch: Sum of stretch times length times the dyad of the direction [m²].
    """
    shear = stretch - wp.identity(n=3, dtype=float) * (wp.trace(stretch) / 3.0)
    # Each bond belongs to two particles; its stiffness is the shear modulus times the spacing.
    area = clay.spacing * clay.spacing
    stress = 0.5 * body.shear_modulus / area * wp.sqrt(0.5 * wp.ddot(shear, shear))
    share = float(0.0)
    if stress > body.yield_stress:
        share = 1.0 - body.yield_stress / stress
    return share


@wp.func
def pair_damping(clay: Clay, body: Body, squares: float, parting: float, rates: float) -> float:
    """A particle's damping of its pairs [N s/m], from its viscosity at the present strain rate.

    Args:
        clay: What all pairs share.
        body: The particle's values.
        squares: Sum of the pairs' squared lengths [m²].
        parting: Sum of length times speed of parting [m²/s].
        rates: Sum of the squared speeds of parting [m²/s²].
    """
    # Few neighbours do not make a particle stiffer than a thread of clay is.
    lengths = wp.max(squares, LEAST_SQUARES * clay.spacing * clay.spacing)
    viscosity = body.consistency
    if body.flow_index != 1.0:
        # Pairs of all directions part at rates whose mean square is 2/15 of D : D.
        mean = parting / lengths
        rate = wp.sqrt(wp.max(15.0 * (rates / lengths - mean * mean), 0.0))
        viscosity *= wp.pow(wp.max(rate, SLOWEST_RATE), body.flow_index - 1.0)
    volume = clay.spacing * clay.spacing * clay.spacing
    damping = DAMPING_OF_VISCOSITY * volume * viscosity / lengths
    return wp.min(damping, body.mass * clay.most_damping)


@wp.func
def bond_hold(clay: Clay, rest_length: float) -> float:
    """How much of its stiffness a bond has, by its rest length [m]."""
    return wp.clamp((clay.break_length - rest_length) * clay.inverse_fade, 0.0, 1.0)


@wp.func
def flow_bond(
    clay: Clay,
    law: PairLaw,
    rest_length: float,
    distance: float,
    dilation: float,
    share: float,
    pressed: bool,
) -> BondFlow:
    """What a bond's rest length becomes in one substep.

    Args:
        clay: What all pairs share.
        law: The pair's values.
        rest_length: Rest length before [m].
        distance: Present distance [m].
        dilation: Mean linear strain of both ends' bonds: a change of volume, which does not yield.
        share: Part of the stretch that flows, mean of both ends.
        pressed: Whether one of the ends is under pressure.
    """
    stretch = distance - rest_length
    volume_stretch = dilation * rest_length
    flow = share * (stretch - volume_stretch)
    if volume_stretch < 0.0 or pressed:
        flow += volume_stretch * wp.min(FORGETTING * share, 1.0)
    softening = 1.0 - share
    overstretch = stretch - flow - law.tension_stretch
    if overstretch > 0.0:
        flow += overstretch
        softening = wp.min(softening, 1.0 - overstretch / stretch)
    bond = BondFlow()
    bond.rest_length = wp.max(rest_length + flow, clay.shortest_length)
    # The consistent tangent of a yielding bond is near zero and lets Newton's method run away; the
    # secant through the origin is safe.
    bond.softening = wp.max(softening, SOFTEST)
    return bond


@wp.func
def kernel_value(clay: Clay, distance: float) -> float:
    """A neighbour's share of the density over that at rest."""
    t = wp.max(1.0 - distance / clay.kernel_radius, 0.0)
    return t * t * t * clay.inverse_rest_sum


@wp.func
def kernel_slope(clay: Clay, distance: float) -> float:
    """How fast that share falls with distance [1/m], positive."""
    t = wp.max(1.0 - distance / clay.kernel_radius, 0.0)
    return 3.0 * t * t * clay.inverse_rest_sum / clay.kernel_radius


@wp.func
def surface_density(clay: Clay, lopsided: wp.vec3) -> float:
    """Density that a particle at a surface lacks for want of neighbours.

    Clay would be pressed together there until the others made up for them.

    Args:
        clay: What all pairs share.
        lopsided: Sum of the neighbours' shares of the density times their directions.
    """
    return wp.max(clay.surface_gain * (wp.length(lopsided) - clay.surface_floor), 0.0)


def _lattice() -> tuple[np.ndarray, np.ndarray]:
    """A particle's neighbours on a cubic lattice of unit spacing, and (1 - r/h)³ of each."""
    axis = np.arange(-2, 3)
    lattice = np.stack(np.meshgrid(axis, axis, axis), -1).reshape(-1, 3)
    distance = np.linalg.norm(lattice, axis=1)
    return lattice, np.maximum(1.0 - distance / KERNEL_RADIUS, 0.0) ** 3


def rest_kernel_sum() -> float:
    """Sum of (1 - r/h)³ over a cubic lattice of unit spacing, the particle itself included."""
    return float(_lattice()[1].sum())


def surface_of_lattice() -> tuple[float, float]:
    """Of a lattice's flat surface: the density missing there, and its lopsidedness."""
    lattice, value = _lattice()
    below = lattice[:, 2] <= 0
    height = lattice[:, 2] / np.maximum(np.linalg.norm(lattice, axis=1), 1.0)
    lopsided = -(value * height)[below].sum()
    return float(value[~below].sum() / value.sum()), float(lopsided / value.sum())


def make_bodies(materials: list[Material], settings: Settings, spacing: float) -> list[Body]:
    """What particles of each material have of their own, at a spacing [m]."""
    bodies = []
    for material in materials:
        body = Body()
        body.mass = material.density * spacing**3
        body.pressure_stiffness = BULK_OVER_SHEAR * material.shear_modulus * spacing**3
        body.shear_modulus = material.shear_modulus
        body.yield_stress = material.yield_stress
        body.consistency = material.viscosity if settings.viscosity else 0.0
        body.flow_index = material.flow_index
        bodies.append(body)
    return bodies


def make_pair_laws(materials: list[Material], spacing: float) -> list[PairLaw]:
    """The law of every ordered pair of materials, row by row.

    The weaker of two materials decides how much tension their bond bears; stiffness is the
    harmonic mean, as of springs in series.
    """
    laws = []
    for one in materials:
        for two in materials:
            law = PairLaw()
            shear = 2.0 / (1.0 / one.shear_modulus + 1.0 / two.shear_modulus)
            law.stiffness = shear * spacing
            tension = min(one.tension_limit, two.tension_limit)
            law.tension_stretch = TENSION * tension * spacing**2 / law.stiffness
            laws.append(law)
    return laws


def make_clay(
    settings: Settings,
    spacing: float,
    material_count: int,
    time_step: float,
) -> Clay:
    """What all pairs share, for substeps of ``time_step`` [s]."""
    clay = Clay()
    clay.spacing = spacing
    clay.time_step = time_step
    clay.kernel_radius = KERNEL_RADIUS * spacing
    clay.inverse_rest_sum = 1.0 / rest_kernel_sum()
    missing, lopsided = surface_of_lattice()
    clay.surface_floor = SURFACE_FLOOR * lopsided
    clay.surface_gain = SURFACE_SHARE * missing / (lopsided - clay.surface_floor)
    clay.form_reach = FORM_REACH * spacing
    clay.press_reach = PRESS_REACH * spacing
    clay.break_length = BREAK_LENGTH * spacing
    clay.inverse_fade = 1.0 / ((BREAK_LENGTH - FADE_LENGTH) * spacing)
    clay.shortest_length = SHORTEST_LENGTH * spacing
    clay.most_damping = MOST_REACH**2 / time_step
    clay.dwell = DWELL
    clay.material_count = material_count
    clay.bonds = int(settings.elastoplasticity)
    return clay
