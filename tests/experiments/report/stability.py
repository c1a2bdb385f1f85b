# SPDX-License-Identifier: GPL-3.0-or-later
"""Stability map of the solver: length of a substep against stiffness of the clay."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from tactile_clay.solver import Material, Scene, Settings, Solver
from tactile_clay.tests.experiments.shapes import at, ball, block

from .meter import FRAME

SUBSTEPS = (1, 2, 3, 4, 6, 8, 12, 16)
"""Numbers of substeps per frame."""
MODULI = tuple(float(10.0 ** (n / 2)) for n in range(7, 17))
"""Shear moduli [Pa]."""
SPACING = 0.005
JITTER_SPEED = 1e-3
"""Clay whose root-mean-square speed exceeds this after half a second alone jitters [m/s]."""
TOOL_SPEED = 0.05
"""Speed of the ball [m/s], slow enough not to add substeps."""
EJECTED_SPEED = 1.0
"""Clay faster than this has blown up [m/s], since nothing else exceeds `TOOL_SPEED`."""


class Behavior(Enum):
    """Behavior of a block of clay."""

    STABLE = "stable"
    JITTER = "jitter"
    BLOWN_UP = "blown up"


@dataclass(frozen=True)
class Cell:
    """A cell of the map."""

    substeps: int
    """Substeps per frame of 1/60 s."""
    shear_modulus: float
    """Shear modulus [Pa]."""
    behavior: Behavior
    """Behavior of the clay."""
    rms_speed: float
    """Root-mean-square speed at the end [m/s]."""
    max_speed: float
    """Highest speed of a particle at any time [m/s]."""

    @property
    def time_step(self) -> float:
        """Length of a substep [s]."""
        return FRAME / self.substeps


def run_cell(substeps: int, shear_modulus: float, settings: Settings) -> Cell:
    """Press a ball into a block on a table, remove it, and observe how the clay comes to rest."""
    scene = Scene(SPACING)
    scene.add_clay(block((8, 8, 6), SPACING), Material(shear_modulus=shear_modulus))
    scene.add_plane()
    sphere = ball(0.012)
    tool = scene.add_mesh(sphere.vertices, sphere.faces)
    height = 6 * SPACING + 0.0125
    tool.set_pose(at(0, 0, height))
    solver = Solver(scene, replace(settings, substeps=substeps))
    fastest, squares = 0.0, []
    for frame in range(60):
        if frame < 10:
            height -= TOOL_SPEED * FRAME
        elif frame < 26:
            height += TOOL_SPEED * FRAME
        tool.set_pose(at(0, 0, height if frame < 26 else 1.0))
        solver.step(FRAME)
        velocities = solver.velocities().astype(float)
        speeds = np.linalg.norm(velocities, axis=1)
        fastest = max(fastest, float(speeds.max()))
        squares.append(float((speeds**2).mean()))
        if not math.isfinite(fastest) or fastest > EJECTED_SPEED:
            break
    figures = solver.diagnostics()
    rms = math.sqrt(float(np.mean(squares[-12:])))
    if not fastest < EJECTED_SPEED or figures.quarantined or figures.clamped:
        behavior = Behavior.BLOWN_UP
    elif rms > JITTER_SPEED:
        behavior = Behavior.JITTER
    else:
        behavior = Behavior.STABLE
    return Cell(substeps, shear_modulus, behavior, rms, fastest)


@dataclass(frozen=True)
class Margin:
    """Distance of the live setting from instability."""

    time_step: float
    """How many times longer a substep can be at the live stiffness."""
    time_step_bounded: bool
    """Whether something unstable lies beyond; otherwise the map ends there."""
    stiffness: float
    """How many times stiffer the clay can be at the live substep."""
    stiffness_bounded: bool
    """Whether something unstable lies beyond; otherwise the map ends there."""


def margin(cells: list[Cell], settings: Settings, shear_modulus: float) -> Margin:
    """Find how far the map is stable beyond the live setting along each axis."""

    def reach(line: list[Cell], measure: str, start: float) -> tuple[float, bool]:
        last = start
        for cell in line:
            if cell.behavior is not Behavior.STABLE:
                return last / start, True
            last = getattr(cell, measure)
        return last / start, False

    nearest = min((c.shear_modulus for c in cells), key=lambda g: abs(math.log(g / shear_modulus)))
    longer = sorted(
        (c for c in cells if c.shear_modulus == nearest and c.substeps <= settings.substeps),
        key=lambda c: c.time_step,
    )
    stiffer = sorted(
        (c for c in cells if c.substeps == settings.substeps and c.shear_modulus >= nearest),
        key=lambda c: c.shear_modulus,
    )
    return Margin(
        *reach(longer, "time_step", FRAME / settings.substeps),
        *reach(stiffer, "shear_modulus", nearest),
    )
