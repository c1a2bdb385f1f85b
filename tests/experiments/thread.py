# SPDX-License-Identifier: GPL-3.0-or-later
"""A thread of clay hanging under its own weight, which holds or draws out."""

import math
from dataclasses import dataclass, replace

import numpy as np
import trimesh

from tactile_clay.solver import Material, Scene, Settings, Solver

from .pieces import pieces
from .shapes import at, block

GRAVITY = 9.81
SINKING = 0.002
"""Speed at which the support is lowered [m/s]."""


@dataclass(frozen=True)
class Thread:
    """A hanging thread at the end."""

    length_ratio: float
    """Length over the longest that holds by theory, √3 τ_y / ρ g."""
    stretch: float
    """Sinking of its end over its length."""
    piece_count: int
    """Number of pieces."""


def hang(
    length_ratio: float = 0.7,
    *,
    width: int = 4,
    length: int = 12,
    duration: float = 1.0,
    spacing: float = 0.005,
    material: Material | None = None,
    settings: Settings | None = None,
) -> Thread:
    """Hang a thread whose yield stress is set by the ratio of its length to the longest that holds.

    Its head, of a clay that does not yield, is held by two jaws. A plate carries the thread at
    first and is lowered, so that the load builds up slowly.

    Args:
        length_ratio: Length over √3 τ_y / ρ g.
        width: Number of particles across.
        length: Number of particles along.
        duration: Duration of the lowering, and of the hanging after it [s].
        spacing: Particle spacing [m].
        material: The clay; its yield stress is not used.
        settings: Solver settings.
    """
    material = material or Material()
    height, head = length * spacing, 4
    stress = material.density * GRAVITY * height / (math.sqrt(3) * length_ratio)
    points = block((width, width, length + head), spacing)
    points += np.random.default_rng(4).uniform(-0.1, 0.1, points.shape) * spacing
    held = points[:, 2] > height
    scene = Scene(spacing)
    scene.add_clay(points[~held], replace(material, yield_stress=stress))
    scene.add_clay(points[held], replace(material, yield_stress=1e6))
    box = trimesh.creation.box((0.02, 2 * width * spacing, 0.8 * head * spacing))
    jaws = [scene.add_mesh(box.vertices, box.faces, friction=20.0) for _ in range(2)]
    for jaw, side in zip(jaws, (-1, 1), strict=True):
        across = side * (0.47 * width * spacing + 0.01)
        jaw.set_pose(at(across, 0, height + 0.5 * head * spacing))
    tray_box = trimesh.creation.box((0.1, 0.1, 0.02))
    tray = scene.add_mesh(tray_box.vertices, tray_box.faces, friction=0.0)
    tray.set_pose(at(0, 0, -0.01))
    solver = Solver(scene, settings)
    solver.begin()
    order = np.argsort(np.concatenate([np.flatnonzero(~held), np.flatnonzero(held)]))
    end = points[:, 2] < 1.0 * spacing

    def low() -> float:
        return float(solver.positions()[order][end, 2].mean())

    before = low()
    for frame in range(round(duration * 60)):
        tray.set_pose(at(0, 0, -0.01 - SINKING * (frame + 1) / 60))
        solver.step(1 / 60)
    tray.set_pose(at(0, 0, -1.0))
    for _ in range(round(duration * 60)):
        solver.step(1 / 60)
    return Thread(
        length_ratio=length_ratio,
        stretch=(before - low()) / height,
        piece_count=len(pieces(solver.positions(), spacing)),
    )
