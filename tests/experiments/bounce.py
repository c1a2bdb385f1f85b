# SPDX-License-Identifier: GPL-3.0-or-later
"""An elastic block dropped on a table: how high it bounces, and how long it touches."""

import math
from dataclasses import dataclass, replace

import numpy as np

from tactile_clay.solver import Material, Scene, Settings, Solver

from .elastic import STIFFNESS_OVER_SHEAR, UNYIELDING
from .shapes import block


@dataclass(frozen=True)
class Bounce:
    """A rebound, compared with the theory of a bar's impact."""

    restitution: float
    """Speed after over speed before: 1 for an elastic bar in one dimension."""
    contact_time: float
    """Duration of contact [s]."""
    expected_time: float
    """2 H / c [s], c = √(E / ρ): a wave runs up the bar and back."""
    substep: float
    """Length of a substep [s], which limits the resolution of that time."""


def bounce(
    speed: float = 0.5,
    *,
    counts: tuple[int, int, int] = (4, 4, 10),
    spacing: float = 0.005,
    material: Material | None = None,
    settings: Settings | None = None,
) -> Bounce:
    """Let a bar that does not yield hit a table end on, without gravity and friction.

    Args:
        speed: Speed of the bar [m/s].
        counts: Particles along each axis.
        spacing: Particle spacing [m].
        material: The clay; its yield stress is not used.
        settings: Solver settings.
    """
    material = replace(
        material or Material(shear_modulus=2e4),
        yield_stress=UNYIELDING,
        cohesion=UNYIELDING,
        viscosity=0.0,
    )
    height = counts[2] * spacing
    stiffness = material.shear_modulus * sum(STIFFNESS_OVER_SHEAR) / 2
    expected = 2 * height / math.sqrt(stiffness / material.density)
    scene = Scene(spacing, gravity=(0, 0, 0))
    scene.add_clay(
        block(counts, spacing, (0, 0, 0.01 * spacing)), material, velocities=(0, 0, -speed)
    )
    table = scene.add_plane(friction=0.0)
    solver = Solver(scene, settings)
    step = 1 / 60 / solver.settings.substeps
    touching = []
    for _ in range(math.ceil(6 * expected / step)):
        solver.step(step)
        touching.append(-solver.force_on(table)[2] > 0.0)
    return Bounce(
        restitution=float(solver.velocities()[:, 2].astype(np.float64).mean() / speed),
        contact_time=sum(touching) * step,
        expected_time=expected,
        substep=step,
    )
