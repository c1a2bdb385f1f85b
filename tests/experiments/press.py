# SPDX-License-Identifier: GPL-3.0-or-later
"""A sphere pressed into a block and removed: force, dent and volume."""

import math
from dataclasses import dataclass

import numpy as np

from tactile_clay.solver import Material, Scene, Settings, Solver

from .shapes import at, ball, block


@dataclass(frozen=True)
class Press:
    """Force on the sphere, and the dent that it leaves."""

    force_moving: float
    """Force at full depth, still moving [N]."""
    force_held: float
    """Force a third of a second later [N]."""
    theory: tuple[float, float]
    """5.7 to 6.05 τ_y A, from the slip-line theory of a round punch [N]."""
    viscous: float
    """Viscous part of the force: 8 η a v, for a round punch on a Newtonian fluid [N]."""
    dent_pressed: float
    """Depth under the sphere while it is held [m]."""
    dent_left: float
    """Depth after it is removed and the clay is at rest [m]."""
    compression_pressed: float
    """Mean compression during the press."""
    compression_left: float
    """Mean compression afterwards."""
    max_penetration: float
    """Deepest penetration of a particle into the sphere [m]."""

    @property
    def spring_back(self) -> float:
        """Fraction of the dent that sprang back."""
        return 1.0 - self.dent_left / self.dent_pressed


def press(
    depth: float = 0.012,
    *,
    radius: float = 0.012,
    speed: float = 0.1,
    spacing: float = 0.005,
    counts: tuple[int, int, int] = (12, 12, 10),
    material: Material | None = None,
    settings: Settings | None = None,
) -> Press:
    """Press a sphere into a block on a table, hold it, and remove it."""
    material = material or Material()
    scene = Scene(spacing)
    scene.add_clay(block(counts, spacing), material)
    scene.add_plane()
    sphere = ball(radius)
    tool = scene.add_mesh(sphere.vertices, sphere.faces)
    tool.set_pose(at(0, 0, 1.0))
    solver = Solver(scene, settings)
    solver.begin()
    for _ in range(12):
        solver.step(1 / 60)
    rest = solver.positions()
    top = float(rest[:, 2].max()) + 0.5 * spacing
    under = (np.hypot(rest[:, 0], rest[:, 1]) < 1.1 * spacing) & (rest[:, 2] > top - spacing)

    def sink() -> float:
        return float((rest[under, 2] - solver.positions()[under, 2]).mean())

    height = top + radius + 0.1 * spacing
    tool.set_pose(at(0, 0, height))
    solver.step(1 / 60)
    forces = []
    penetration = 0.0
    while height > top + radius - depth + 1e-9:
        height = max(height - speed / 60, top + radius - depth)
        tool.set_pose(at(0, 0, height))
        solver.step(1 / 60)
        forces.append(float(solver.force_on(tool)[2]))
        penetration = max(penetration, solver.diagnostics().max_penetration)
    moving = float(np.mean(forces[-2:]))
    for _ in range(20):
        solver.step(1 / 60)
    held = float(solver.force_on(tool)[2])
    dent_pressed, pressed = sink(), solver.diagnostics().volume_error
    for _ in range(10):
        height += 2 * speed / 60
        tool.set_pose(at(0, 0, height))
        solver.step(1 / 60)
    for _ in range(30):
        solver.step(1 / 60)
    area = math.pi * (2 * radius * depth - depth**2)
    return Press(
        force_moving=moving,
        force_held=held,
        theory=(5.7 * material.yield_stress * area, 6.05 * material.yield_stress * area),
        viscous=8.0 * material.viscosity * math.sqrt(area / math.pi) * speed,
        dent_pressed=dent_pressed,
        dent_left=sink(),
        compression_pressed=pressed,
        compression_left=solver.diagnostics().volume_error,
        max_penetration=penetration,
    )
