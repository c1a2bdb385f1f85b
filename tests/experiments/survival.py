# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a scene is survived: the clay stays finite, ejects nothing and comes to rest."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_clay.solver import Material, Scene, Settings, Solver

SPACING = 0.005
RELEASE_SPEED = 1.0
"""Input speed of cases without any other [m/s]: clay that overlaps itself holds more energy than
real clay can, and may release it at about this speed."""


@dataclass(frozen=True)
class HardCase:
    """The outcome of a hard case."""

    finite: bool
    """Whether all positions and velocities were finite after every step."""
    ejection_ratio: float
    """Highest speed of a particle over the input speed; 0 if nothing could move."""
    recovered: bool
    """Whether the clay is at rest at the end, or the result correct if the case has a known one."""
    clamped: int
    """Number of clamped velocities."""
    quarantined: int
    """Number of times a particle was held because its state was not finite."""
    overflow: int
    """Number of neighbors dropped for lack of room."""
    teleported: int
    """Number of jumps of colliders."""
    note: str
    """Remark for the table."""

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
    """Step a scene, and judge the outcome.

    Args:
        scene: The scene.
        frames: Number of steps.
        speed_in: Input speed [m/s]: of the clay, a tool or a fall.
        drive: Called before each step, to move tools.
        step: Length of each step [s].
        calm: Speed below which the clay counts as at rest [m/s].
        note: Remark for the table.
        settings: Solver settings.
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
    """Combine a case's outcome with the solver's counts."""
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
    """Make a scene of clay over a table."""
    scene = Scene(SPACING, gravity=(0, 0, -gravity))
    scene.add_clay(points, material or Material(), velocities=velocities)
    scene.add_plane()
    return scene
