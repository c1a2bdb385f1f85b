# SPDX-License-Identifier: GPL-3.0-or-later
"""A block resting on a table for a very long time."""

from dataclasses import dataclass

import numpy as np

from tactile_clay.solver import Material, Scene, Settings, Solver

from .shapes import block

GRAVITY = 9.81


@dataclass(frozen=True)
class Rest:
    """The changes of a block after it has settled."""

    steps: int
    """Number of steps after settling."""
    drift: float
    """Largest motion of a particle, in spacings."""
    energy_early: float
    """Largest kinetic energy in the first tenth, over m g d."""
    energy_late: float
    """Largest kinetic energy in the last tenth, over m g d."""
    volume_change: float
    """Change of the mean compression."""
    height_change: float
    """Relative change of the block's height."""
    weight_ratios: tuple[float, float]
    """Smallest and largest force on the table over m g."""


def rest(
    steps: int = 10_000,
    *,
    counts: int = 5,
    settle: int = 60,
    step: float = 1 / 60,
    looks: int = 100,
    spacing: float = 0.005,
    material: Material | None = None,
    settings: Settings | None = None,
) -> Rest:
    """Put a block on a table and leave it there.

    Args:
        steps: Number of steps after it has settled.
        counts: Number of particles along each edge.
        settle: Number of steps before.
        step: Length of a step [s].
        looks: Number of measurements.
        spacing: Particle spacing [m].
        material: The clay.
        settings: Solver settings.
    """
    material = material or Material()
    scene = Scene(spacing)
    scene.add_clay(block(counts, spacing), material)
    table = scene.add_plane()
    solver = Solver(scene, settings)
    mass = counts**3 * material.density * spacing**3
    for _ in range(settle):
        solver.step(step)
    begin = solver.positions().astype(np.float64)
    compression = solver.diagnostics().volume_error
    energies, weights, drift = [], [], 0.0
    every = max(1, steps // looks)
    for number in range(1, steps + 1):
        solver.step(step)
        if number % every == 0:
            speeds = solver.velocities().astype(np.float64)
            energies.append(0.5 * (speeds**2).sum(1).mean() / (GRAVITY * spacing))
            weights.append(float(-solver.force_on(table)[2]) / (mass * GRAVITY))
            moved = np.linalg.norm(solver.positions() - begin, axis=1).max()
            drift = max(drift, float(moved) / spacing)
    end = solver.positions().astype(np.float64)
    tenth = max(1, len(energies) // 10)
    return Rest(
        steps=steps,
        drift=drift,
        energy_early=float(max(energies[:tenth])),
        energy_late=float(max(energies[-tenth:])),
        volume_change=solver.diagnostics().volume_error - compression,
        height_change=float(np.ptp(end[:, 2]) / np.ptp(begin[:, 2]) - 1.0),
        weight_ratios=(min(weights), max(weights)),
    )
