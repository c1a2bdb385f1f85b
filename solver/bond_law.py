# SPDX-License-Identifier: GPL-3.0-or-later
"""The law of the clay: how a bond yields and flows, and what pressure answers compression.

After the semi-permanent distance constraints of Barreiro, Torres and Otaduy, *Natural Tactile
Interaction with Virtual Clay*, WHC 2021 (eq. 5), with these differences: a bond is a spring of
physical stiffness instead of a rigid constraint; it yields by stress instead of by a rate of
separation, so that slow hands can model it too; and it flows with the material's viscosity, which
takes the place of the strain-rate constraint (eqs. 3 and 4).
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
VOLUME_MEMORY = 0.01
"""Time in which yielding bonds forget a change of volume [s]; the pressure keeps it instead."""
YIELD_FORCE_FACTOR = 0.6
"""Yield force of a bond over τ_y d², fitted to slip-line theory of indentation."""
BULK_OVER_SHEAR = 3.0
"""Bulk modulus over shear modulus: clay hardly compresses."""


@wp.struct
class PairLaw:
    """How particles of two given materials act on each other, for one time step."""

    stiffness: float
    """Bond stiffness [N/m]."""
    yield_stretch: float
    """Shear stretch at which a bond flows [m]."""
    tension_stretch: float
    """Total stretch that a bond can carry in tension [m]."""
    flow_fraction: float
    """Part of the excess stretch that flows in one substep."""


@wp.struct
class Body:
    """What a particle of a material has of its own."""

    mass: float
    """[kg]"""
    pressure_stiffness: float
    """Bulk modulus times particle volume [J]."""


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
    forget_fraction: float
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
def flow_bond(
    clay: Clay,
    law: PairLaw,
    rest_length: float,
    distance: float,
    stretch_sum: float,
    pressed: bool,
) -> BondFlow:
    """The yield law: what a bond's rest length becomes in one substep.

    Args:
        clay: What all pairs share.
        law: The pair's values.
        rest_length: Rest length before [m].
        distance: Present distance [m].
        stretch_sum: Mean stretch of both ends' bonds, added [m]: a change of volume, which does
            not yield.
        pressed: Whether one of the ends is under pressure.
    """
    stretch = distance - rest_length
    volume_stretch = 0.5 * stretch_sum * rest_length / clay.spacing
    shear_stretch = stretch - volume_stretch
    excess = wp.abs(shear_stretch) - law.yield_stretch
    flow = float(0.0)
    flows = bool(False)
    if excess > 0.0:
        flows = True
        flow = wp.sign(shear_stretch) * excess * law.flow_fraction
        if volume_stretch < 0.0 or pressed:
            flow += volume_stretch * clay.forget_fraction
    overstretch = stretch - flow - law.tension_stretch
    if overstretch > 0.0:
        flows = True
        flow += overstretch * law.flow_fraction
    bond = BondFlow()
    bond.rest_length = wp.max(rest_length + flow, clay.shortest_length)
    bond.softening = 1.0
    if flows:
        # The consistent tangent of a yielding bond is near zero and lets Newton's method run
        # away; the secant through the origin is safe.
        whole = wp.max(wp.abs(shear_stretch), wp.abs(stretch))
        left = wp.where(
            wp.abs(shear_stretch) > wp.abs(stretch), shear_stretch - flow, stretch - flow
        )
        bond.softening = wp.clamp(
            wp.abs(left) / wp.max(whole, 1.0e-12), 1.0 - law.flow_fraction, 1.0
        )
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


def make_bodies(materials: list[Material], spacing: float) -> list[Body]:
    """What particles of each material have of their own, at a spacing [m]."""
    bodies = []
    for material in materials:
        body = Body()
        body.mass = material.density * spacing**3
        body.pressure_stiffness = BULK_OVER_SHEAR * material.shear_modulus * spacing**3
        bodies.append(body)
    return bodies


def make_pair_laws(
    materials: list[Material], settings: Settings, spacing: float, time_step: float
) -> list[PairLaw]:
    """The law of every ordered pair of materials, row by row.

    The weaker of two materials decides where their bond yields; stiffness is the harmonic mean,
    as of springs in series.
    """
    laws = []
    for one in materials:
        for two in materials:
            law = PairLaw()
            shear = 2.0 / (1.0 / one.shear_modulus + 1.0 / two.shear_modulus)
            law.stiffness = shear * spacing
            scale = YIELD_FORCE_FACTOR * spacing**2 / law.stiffness
            law.yield_stretch = scale * min(one.yield_stress, two.yield_stress)
            law.tension_stretch = scale * min(one.tension_limit, two.tension_limit)
            viscosity = 0.5 * (one.viscosity + two.viscosity) if settings.viscosity else 0.0
            law.flow_fraction = time_step / (time_step + viscosity * spacing / law.stiffness)
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
    clay.forget_fraction = time_step / (time_step + VOLUME_MEMORY)
    clay.material_count = material_count
    clay.bonds = int(settings.elastoplasticity)
    return clay
