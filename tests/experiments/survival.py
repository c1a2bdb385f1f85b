# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a scene is survived: the clay stays finite, throws nothing and comes to rest."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_clay.solver import Material, Scene, Settings, Solver

SPACING = 0.005
RELEASE_SPEED = 1.0
"""Clay that overlaps itself holds more energy than clay can; this is what it may be let out
with [m/s], where no speed went in otherwise."""


@dataclass(frozen=True)
class HardCase:
    """What happened."""

    finite: bool
    """All positions and velocities were finite after every step."""
    ejection_ratio: float
    """Fastest particle of all over what went in; 0 where nothing could move."""
    recovered: bool
    """At rest at the end, or exact where the case has an exact result."""
    clamped: int
    """Velocities that were shortened."""
    quarantined: int
    """Particles held because their state was not finite."""
    overflow: int
    """Neighbors that found no room."""
    teleported: int
    """Jumps of colliders."""
    note: str
    """What else is worth saying."""

    @property
    def passed(self) -> bool:
        """Whether the case is survived."""
        return self.finite and self.ejection_ratio <= 2.0 and self.recovered


def survive(
    scene: Scene,
    frames: int = 60,
    *,
    speed_in: float = RELEASE_SPEED,
    drive: Callable[[int], None] = lambda frame: None,
    step: float = 1 / 60,
    calm: float = 0.02,
    note: str = "",
    settings: Settings | None = None,
) -> HardCase:
    """Step a scene and look what becomes of it.

    Args:
        scene: The scene.
        frames: How many steps.
        speed_in: What goes in [m/s]: of the clay, of a tool, of a fall.
        drive: Called before each step, to move tools.
        step: Length of each step [s].
        calm: Speed below which the clay counts as at rest [m/s].
        note: For the table.
        settings: Of the solver.
    """
    solver = Solver(scene, settings)
    fastest, finite = 0.0, True
    for frame in range(frames):
        drive(frame)
        solver.step(step)
        finite &= bool(
            np.isfinite(solver.positions()).all() and np.isfinite(solver.velocities()).all()
        )
        fastest = max(fastest, solver.diagnostics().max_speed)
    return judge(solver, finite, fastest / speed_in, solver.diagnostics().max_speed < calm, note)


def judge(
    solver: Solver, finite: bool, ejection_ratio: float, recovered: bool, note: str
) -> HardCase:
    """Put a case's outcome and the solver's counts together."""
    state = solver.diagnostics()
    return HardCase(
        finite=finite,
        ejection_ratio=ejection_ratio,
        recovered=recovered,
        clamped=state.clamped,
        quarantined=state.quarantined,
        overflow=state.overflow,
        teleported=state.teleported,
        note=note,
    )


def on_table(
    points: NDArray[np.float64],
    material: Material | None = None,
    *,
    gravity: float = 9.81,
    velocities: tuple[float, float, float] | NDArray[np.float64] = (0.0, 0.0, 0.0),
) -> Scene:
    """Clay over a table."""
    scene = Scene(SPACING, gravity=(0, 0, -gravity))
    scene.add_clay(points, material or Material(), velocities=velocities)
    scene.add_plane()
    return scene
