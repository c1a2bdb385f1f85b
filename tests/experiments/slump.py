# SPDX-License-Identifier: GPL-3.0-or-later
"""A cylinder of soft clay slumping under its own weight, compared with theory."""

import math
from dataclasses import dataclass

import numpy as np

from tactile_clay.solver import Material, Scene, Settings, Solver

from .shapes import cylinder

DENSITY = 1800.0
GRAVITY = 9.81


@dataclass(frozen=True)
class Slump:
    """Sinking of the top over the height, measured and by theory."""

    measured: float
    """Slump over height."""
    pashias: float
    """s′ = 1 − 2τ′(1 − ln 2τ′), Pashias, Boger, Summers and Glenister 1996,
    doi 10.1122/1.550780."""
    von_mises: float
    """The same for a von Mises material: √3 τ′ in place of 2 τ′."""


def slump(
    yield_ratio: float,
    *,
    height: float = 0.06,
    layers: int = 10,
    duration: float = 1.0,
    settings: Settings | None = None,
) -> Slump:
    """Let a cylinder with τ_y / ρ g H = ``yield_ratio`` slump on a rough table."""
    spacing = height / layers
    material = Material(
        density=DENSITY,
        yield_stress=yield_ratio * DENSITY * GRAVITY * height,
        viscosity=20.0,
        shear_modulus=1e5,
        friction=1.0,
    )
    scene = Scene(spacing)
    scene.add_clay(cylinder(0.5 * height, height, spacing), material)
    scene.add_plane(friction=1.0)
    solver = Solver(scene, settings)
    for _ in range(round(duration * 60)):
        solver.step(1 / 60)
    top = np.sort(solver.positions()[:, 2])[-6:].mean() + 0.5 * spacing
    return Slump(
        measured=float(1.0 - top / height),
        pashias=_theory(2.0 * yield_ratio),
        von_mises=_theory(math.sqrt(3.0) * yield_ratio),
    )


def _theory(ratio: float) -> float:
    return 1.0 - ratio * (1.0 - math.log(ratio)) if ratio < 1.0 else 0.0
