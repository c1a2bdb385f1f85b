# SPDX-License-Identifier: GPL-3.0-or-later
"""The law of the clay: how a bond yields and flows, and what pressure answers compression.

After the semi-permanent distance constraints of Barreiro, Torres and Otaduy, *Natural Tactile
Interaction with Virtual Clay*, WHC 2021 (eq. 5), with these differences: a bond is a spring of
physical stiffness instead of a rigid constraint; it yields by stress instead of by a rate of
separation, so that slow hands can model it too; and it flows with the material's viscosity, which
takes the place of the strain-rate constraint (eqs. 3 and 4).

How much flows is decided by each particle: from its bonds it has a stress, and where the shear of
that (von Mises) is more than the yield stress, the stretch of all its bonds relaxes by one share
(radial return; Simo and Hughes, *Computational Inelasticity*, 1998, section 3.3), such that the
stress left is that of a Herschel-Bulkley fluid at the rate at which it flows. So the yield stress
is that of shear in any direction, whatever the bonds' arrangement, and nothing is fitted.
"""

import numpy as np
import warp as wp

from .material import Material
from .settings import Settings

KERNEL_RADIUS = 2.0
"""Reach of the density kernel, in spacings."""
BOND_REACH = 1.5
"""Pairs closer than this at the start are bonded, in spacings."""
FORM_REACH = 1.25
"""Free pairs closer than this become bonded, in spacings."""
BREAK_LENGTH = 1.9
"""A bond longer than this is gone, in spacings."""
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
BULK_OVER_SHEAR = 3.0
"""Bulk modulus over shear modulus: clay hardly compresses."""


@wp.struct
class PairLaw:
    """How particles of two given materials act on each other, for one time step."""

    stiffness: float
    """Bond stiffness [N/m]."""
    tension_stretch: float
    """Total stretch that a bond can carry in tension [m]."""
    draw: float
    """Part of the stretch beyond that by which a bond draws out in one substep."""


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
    """Stress beyond the yield stress at a strain rate of 1/s [Pa]."""
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
    form_reach: float
    break_length: float
    shortest_length: float
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
def flow_rate(stiff: float, consistency: float, index: float, excess: float) -> float:
    """Solve stiff·x + consistency·x^index = excess for the rate x [1/s]."""
    rate = excess / (stiff + consistency)
    if index != 1.0 and consistency > 0.0:
        rate = wp.min(excess / stiff, wp.pow(excess / consistency, 1.0 / index))
        if index < 1.0:
            # From below, Newton's method stays below: the left side is concave.
            rate *= wp.pow(2.0, -1.0 / index)
        for _ in range(4):
            drag = consistency * wp.pow(rate, index)
            rate += (excess - stiff * rate - drag) / (stiff + index * drag / rate)
    return rate


@wp.func
def flow_share(clay: Clay, body: Body, lengths: float, stretch: wp.mat33) -> float:
    """The yield law: part of their stretch that a particle's bonds lose in one substep.

    Args:
        clay: What all pairs share.
        body: The particle's values.
        lengths: Sum of the bonds' squared rest lengths [m²].
        stretch: Sum of stretch times length times the dyad of the direction [m²].
    """
    shear = stretch - wp.identity(n=3, dtype=float) * (wp.trace(stretch) / 3.0)
    # Each bond belongs to two particles; its stiffness is the shear modulus times the spacing.
    area = clay.spacing * clay.spacing
    stress = 0.5 * body.shear_modulus / area * wp.sqrt(0.5 * wp.ddot(shear, shear))
    excess = stress - body.yield_stress
    share = float(0.0)
    if excess > 0.0:
        # The shear modulus of the bonds that are there.
        stiff = body.shear_modulus * lengths / (30.0 * area) * clay.time_step
        share = stiff * flow_rate(stiff, body.consistency, body.flow_index, excess) / stress
    return share


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
        flow += overstretch * law.draw
        softening = wp.min(softening, 1.0 - law.draw * overstretch / stretch)
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


def rest_kernel_sum() -> float:
    """Sum of (1 - r/h)³ over a cubic lattice of unit spacing, the particle itself included."""
    axis = np.arange(-2, 3)
    lattice = np.stack(np.meshgrid(axis, axis, axis), -1).reshape(-1, 3)
    distance = np.linalg.norm(lattice, axis=1)
    return float((np.maximum(1.0 - distance / KERNEL_RADIUS, 0.0) ** 3).sum())


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


def make_pair_laws(
    materials: list[Material], settings: Settings, spacing: float, time_step: float
) -> list[PairLaw]:
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
            viscosity = 0.5 * (one.viscosity + two.viscosity) if settings.viscosity else 0.0
            law.draw = time_step / (time_step + viscosity * spacing / law.stiffness)
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
    clay.form_reach = FORM_REACH * spacing
    clay.break_length = BREAK_LENGTH * spacing
    clay.shortest_length = SHORTEST_LENGTH * spacing
    clay.dwell = DWELL
    clay.material_count = material_count
    clay.bonds = int(settings.elastoplasticity)
    return clay
