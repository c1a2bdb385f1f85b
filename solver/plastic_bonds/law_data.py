# SPDX-License-Identifier: GPL-3.0-or-later
"""The parameters of the clay's law, and how they follow from materials.

The formulas themselves, with the constants that only they use, are in `law`.
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
"""Free pairs closer than this begin to press on each other, in spacings. They continue up to the
length at which bonds break: with a single threshold, pairs would jitter."""
SURFACE_FLOOR = 0.4
"""Asymmetry up to which a particle counts as inside the clay, relative to a flat surface's."""
SURFACE_SHARE = 0.8
"""Fraction of the neighbors missing at a surface that is compensated. With 1, thin necks of clay
swell and break early; with 0, kneaded clay loses a tenth of its volume."""
BREAK_LENGTH = 1.9
"""A bond longer than this breaks, in spacings."""
FADE_LENGTH = 1.5
"""Bonds longer than this weaken gradually, in spacings: breaking under full load would jolt the
clay."""
MIN_REST_LENGTH = 0.6
"""Rest lengths never fall below this, in spacings."""
DWELL = 2.0
"""Substeps for which a free pair must stay close to bond, so that passing neighbors do not."""
TENSION = 1.0
"""Force at which a bond draws out, relative to the tension limit times d². It is more than bonds
carry in shear at the same stress, so that it limits all-round tension only."""
MAX_VISCOUS_REACH = 64.0
"""Viscosity is capped so that it carries motion no farther than this in a substep, in spacings: the
solve could not resolve more."""
BULK_OVER_SHEAR = 3.0
"""Bulk modulus over shear modulus: clay is nearly incompressible."""


@wp.struct
class PairLaw:
    """How particles of two given materials act on each other."""

    stiffness: float
    """Bond stiffness [N/m]."""
    tension_stretch: float
    """Total stretch that a bond can carry in tension [m]."""


@wp.struct
class ParticleLaw:
    """Values of a particle that depend on its material alone."""

    mass: float
    """Mass of a particle [kg]."""
    pressure_stiffness: float
    """Bulk modulus times particle volume [J]."""
    shear_modulus: float
    """[Pa]"""
    yield_stress: float
    """[Pa]"""
    consistency: float
    """Viscous stress at a strain rate of 1/s [Pa]."""
    flow_index: float
    """Exponent of the strain rate."""


@wp.struct
class SharedLaw:
    """Values that all pairs share, for one length of substep."""

    spacing: float
    """Particle spacing at rest [m]."""
    time_step: float
    """[s]"""
    kernel_radius: float
    """Reach h of the density kernel [m]."""
    inverse_rest_sum: float
    """1 over the sum of (1 - r/h)³ at rest."""
    surface_gain: float
    """Relative density that a particle gains per asymmetry beyond the floor."""
    surface_floor: float
    """Asymmetry that particles inside the clay have by chance."""
    form_reach: float
    """Free pairs closer than this become bonded [m]; 0 if nothing bonds."""
    press_reach: float
    """Free pairs closer than this begin to press on each other [m]."""
    break_length: float
    """Bonds, and free pairs that press, let go beyond this [m]."""
    inverse_fade: float
    """1 over the length over which bonds weaken [1/m]."""
    min_rest_length: float
    """[m]"""
    max_damping: float
    """Largest damping of a pair, over mass [1/s]."""
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
    """Relative density missing at a lattice's flat surface, and the asymmetry there."""
    lattice, value = _lattice()
    below = lattice[:, 2] <= 0
    height = lattice[:, 2] / np.maximum(np.linalg.norm(lattice, axis=1), 1.0)
    lopsided = -(value * height)[below].sum()
    return float(value[~below].sum() / value.sum()), float(lopsided / value.sum())


def make_particle_laws(
    materials: list[Material], settings: Settings, spacing: float
) -> list[ParticleLaw]:
    """Values of particles of each material, at a spacing [m]."""
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

    The weaker of two materials limits the tension of their bond; the stiffness is the harmonic
    mean, as for springs in series.
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
    """Values that all pairs share, for substeps of ``time_step`` [s]."""
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
