# SPDX-License-Identifier: GPL-3.0-or-later
"""A cylinder of clay pressed flat between two plates: force against plasticity theory."""

import math
from dataclasses import dataclass, replace

import numpy as np
import trimesh

from tactile_clay.solver import Material, Scene, Settings, Solver

from .shapes import at, cylinder


@dataclass(frozen=True)
class Compression:
    """Force on the upper plate while it moves."""

    force: float
    """Measured force [N]."""
    expected: float
    """√3 τ_y A between smooth plates, (√3 τ_y + 2 τ_y R / 3 h) A between sticking ones [N]; A and R
    are those of a cylinder of the same volume (upper bound of a sticking disc, Siebel)."""
    expected_uniaxial: float
    """√3 τ_y A [N]."""
    radius_ratio: float
    """RMS radius over that at constant volume."""

    @property
    def ratio(self) -> float:
        """Measured over expected."""
        return self.force / self.expected


def compress_cylinder(
    *,
    strain: float = 0.15,
    sticking: bool = False,
    radius: float = 0.02,
    height: float = 0.02,
    speed: float = 0.02,
    spacing: float = 0.004,
    material: Material | None = None,
    settings: Settings | None = None,
) -> Compression:
    """Press a cylinder by ``strain`` of its height, without gravity.

    Args:
        strain: Compression over the height.
        sticking: Whether the clay sticks to the plates or slides freely.
        radius: Radius of the cylinder [m].
        height: Height of the cylinder [m].
        speed: Speed of the plate [m/s].
        spacing: Particle spacing [m].
        material: The clay; by default with 10 kPa and little viscosity.
        settings: Solver settings.
    """
    material = material or Material(yield_stress=1e4, viscosity=20.0, shear_modulus=2e5)
    friction = 20.0 if sticking else 0.0
    scene = Scene(spacing, gravity=(0, 0, 0))
    points = cylinder(radius, height, spacing)
    scene.add_clay(points, replace(material, friction=1.0))
    box = trimesh.creation.box((6 * radius, 6 * radius, 0.02))
    scene.add_mesh(box.vertices + np.array((0, 0, -0.01)), box.faces, friction=friction)
    lid = scene.add_mesh(box.vertices, box.faces, friction=friction)
    lid.set_pose(at(0, 0, height + 0.01))
    solver = Solver(scene, settings)
    solver.begin()
    for _ in range(6):
        solver.step(1 / 60)
    place, forces = height, []
    while place > (1 - strain) * height + 1e-9:
        place = max(place - speed / 60, (1 - strain) * height)
        lid.set_pose(at(0, 0, place + 0.01))
        solver.step(1 / 60)
        forces.append(float(solver.force_on(lid)[2]))
    # From the particles' volume, because the lattice does not fill the cylinder exactly.
    area = len(points) * spacing**3 / place
    uniaxial = math.sqrt(3) * material.yield_stress * area
    extra = 2 * material.yield_stress * math.sqrt(area / math.pi) / (3 * place) * area
    after = solver.positions().astype(np.float64)
    width = np.sqrt((after[:, :2] ** 2).sum(1).mean())
    wide = np.sqrt((points[:, :2] ** 2).sum(1).mean()) / math.sqrt(1 - strain)
    return Compression(
        force=float(np.mean(forces[-3:])),
        expected=uniaxial + extra if sticking else uniaxial,
        expected_uniaxial=uniaxial,
        radius_ratio=float(width / wide),
    )
