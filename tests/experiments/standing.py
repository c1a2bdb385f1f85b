# SPDX-License-Identifier: GPL-3.0-or-later
"""Clay on a table or an incline: its weight, sticking and sliding."""

import math
from dataclasses import dataclass

import numpy as np

from tactile_clay.solver import Material, Scene, Settings, Solver

from .shapes import block

GRAVITY = 9.81


@dataclass(frozen=True)
class Standing:
    """A block on a tilted plane."""

    normal_force: float
    """Mean force normal to the plane over m g."""
    tangential_force: float
    """Mean force along the plane over m g."""
    acceleration: float
    """Acceleration along the plane [m/s²]."""
    slip: float
    """Sliding distance of the lowest layer after settling [m]."""
    drift: float
    """Largest motion of a particle after settling [m]."""
    kinetic_energy: float
    """Kinetic energy at the end [J]."""


def stand(
    angle: float = 0.0,
    *,
    friction: float = 0.5,
    counts: int = 7,
    duration: float = 1.5,
    settle: float = 0.5,
    settings: Settings | None = None,
) -> Standing:
    """Put a block on a plane tilted by ``angle`` [rad], by tilting gravity instead."""
    spacing = 0.005
    material = Material(friction=friction)
    scene = Scene(spacing, (GRAVITY * math.sin(angle), 0.0, -GRAVITY * math.cos(angle)))
    scene.add_clay(block(counts, spacing), material)
    plane = scene.add_plane(friction=friction)
    solver = Solver(scene, settings)
    mass = counts**3 * material.density * spacing**3
    lowest = solver.positions()[:, 2] < spacing
    settled = solver.positions()
    forces, speeds = [], []
    steps, settling = round(duration * 60), round(settle * 60)
    for step in range(steps):
        solver.step(1 / 60)
        if step < settling:
            settled = solver.positions()
        else:
            forces.append(-solver.force_on(plane))
            speeds.append(float(solver.velocities()[:, 0].mean()))
    moved = solver.positions() - settled
    force = np.mean(forces, axis=0) / (mass * GRAVITY)
    velocity = solver.velocities().astype(float)
    return Standing(
        normal_force=float(force[2]),
        tangential_force=float(-force[0]),
        acceleration=float(np.polyfit(np.arange(len(speeds)) / 60, speeds, 1)[0]),
        slip=float(moved[lowest, 0].mean()),
        drift=float(np.linalg.norm(moved, axis=1).max()),
        kinetic_energy=float(0.5 * mass / counts**3 * (velocity**2).sum()),
    )
