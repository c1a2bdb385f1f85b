# SPDX-License-Identifier: GPL-3.0-or-later
"""The numbers that the law of the clay works with, and how they follow from materials.

The formulas themselves, with the constants that appear in them alone, are in `law`.
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
"""Free pairs closer than this begin to press on each other, in spacings. They go on until they are
as far apart as bonds that break: pairs that came and went at one distance would jitter."""
SURFACE_FLOOR = 0.4
"""Lopsidedness up to which a particle counts as inside the clay, over that at a flat surface."""
SURFACE_SHARE = 0.8
"""Fraction of the neighbors missing at a surface that is made up for. With all of them, thin necks
of clay swell and part early; with none, kneaded clay loses a tenth of its volume."""
BREAK_LENGTH = 1.9
"""A bond longer than this breaks, in spacings."""
FADE_LENGTH = 1.5
"""A bond longer than this holds less and less, in spacings: breaking under its full load would
jolt the clay."""
MIN_REST_LENGTH = 0.6
"""Rest lengths never fall below this, in spacings."""
DWELL = 2.0
"""Substeps a free pair must stay close before it bonds: a neighbor rushing by is not caught."""
TENSION = 1.0
"""Force at which a bond draws out, over the tension limit times d². It is more than bonds carry
where the clay shears at the same stress, so that it limits all-round tension only."""
MAX_VISCOUS_REACH = 64.0
"""Viscosity is capped at what carries motion this far in a substep, in spacings: the solve could
not resolve more."""
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
class ParticleLaw:
    """What a particle has from its material alone."""

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
class SharedLaw:
    """What all pairs share, for one length of substep."""

    spacing: float
    """Of particles at rest [m]."""
    time_step: float
    """[s]"""
    kernel_radius: float
    """Reach h of the density kernel [m]."""
    inverse_rest_sum: float
    """1 over the sum of (1 - r/h)³ at rest."""
    surface_gain: float
    """What lopsidedness beyond the floor adds to a particle's density."""
    surface_floor: float
    """Lopsidedness that particles inside the clay have by chance."""
    form_reach: float
    """Free pairs closer than this become bonded [m]; 0 where nothing bonds."""
    press_reach: float
    """Free pairs closer than this begin to press on each other [m]."""
    break_length: float
    """Bonds, and free pairs that press, let go beyond this [m]."""
    inverse_fade: float
    """1 over the length on which bonds fade [1/m]."""
    min_rest_length: float
    """[m]"""
    max_damping: float
    """Of a pair, over mass [1/s]."""
    dwell: float
    """Substeps a free pair must stay close before it bonds."""
    material_count: int


def _lattice() -> tuple[np.ndarray, np.ndarray]:
    """Neighbors on a cubic lattice of unit spacing, and the kernel of `law` at each."""
    axis = np.arange(-2, 3)
    lattice = np.stack(np.meshgrid(axis, axis, axis), -1).reshape(-1, 3)
    distance = np.linalg.norm(lattice, axis=1)
    return lattice, np.maximum(1.0 - distance / KERNEL_RADIUS, 0.0) ** 3


def rest_kernel_sum() -> float:
    """Sum of (1 - r/h)³ over a cubic lattice of unit spacing, the particle itself included."""
    return float(_lattice()[1].sum())


def surface_of_lattice() -> tuple[float, float]:
    """Density missing at a lattice's flat surface, and lopsidedness there."""
    lattice, value = _lattice()
    below = lattice[:, 2] <= 0
    height = lattice[:, 2] / np.maximum(np.linalg.norm(lattice, axis=1), 1.0)
    lopsided = -(value * height)[below].sum()
    return float(value[~below].sum() / value.sum()), float(lopsided / value.sum())


def make_particle_laws(
    materials: list[Material], settings: Settings, spacing: float
) -> list[ParticleLaw]:
    """The values of particles of each material, at a spacing [m]."""
    laws = []
    for material in materials:
        law = ParticleLaw()
        law.mass = material.density * spacing**3
        law.pressure_stiffness = BULK_OVER_SHEAR * material.shear_modulus * spacing**3
        law.shear_modulus = material.shear_modulus
        law.yield_stress = material.yield_stress
        law.consistency = material.viscosity if settings.viscosity else 0.0
        law.flow_index = material.flow_index
        laws.append(law)
    return laws


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


def make_shared_law(
    settings: Settings,
    spacing: float,
    material_count: int,
    time_step: float,
) -> SharedLaw:
    """What all pairs share, for substeps of ``time_step`` [s]."""
    shared = SharedLaw()
    shared.spacing = spacing
    shared.time_step = time_step
    shared.kernel_radius = KERNEL_RADIUS * spacing
    shared.inverse_rest_sum = 1.0 / rest_kernel_sum()
    missing, lopsided = surface_of_lattice()
    shared.surface_floor = SURFACE_FLOOR * lopsided
    shared.surface_gain = SURFACE_SHARE * missing / (lopsided - shared.surface_floor)
    shared.form_reach = FORM_REACH * spacing if settings.elastoplasticity else 0.0
    shared.press_reach = PRESS_REACH * spacing
    shared.break_length = BREAK_LENGTH * spacing
    shared.inverse_fade = 1.0 / ((BREAK_LENGTH - FADE_LENGTH) * spacing)
    shared.min_rest_length = MIN_REST_LENGTH * spacing
    shared.max_damping = MAX_VISCOUS_REACH**2 / time_step
    shared.dwell = DWELL
    shared.material_count = material_count
    return shared
