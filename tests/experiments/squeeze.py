# SPDX-License-Identifier: GPL-3.0-or-later
"""A block kneaded between plates a hundred times: does it keep its volume?"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pysplashsurf
import trimesh
from numpy.typing import NDArray

from tactile_clay.solver import Material, Scene, Settings, Solver
from tactile_clay.solver.geometry.closed_mesh import mesh_volume

from .pieces import pieces
from .shapes import at, block


@dataclass(frozen=True)
class Squeeze:
    """What many squeezes did to a block."""

    squeezes: int
    """How many."""
    compression_change: float
    """Change of the mean compression, at rest before and after."""
    surface_change: float
    """Change of the volume inside the reconstructed surface, over the volume."""
    density_change: float
    """Change of the mean number of neighbors within two spacings of inner particles, over it."""
    pieces: int
    """What the block is in at the end."""
    shortening: float
    """How much thinner the block was in the last squeeze than before it."""


def squeeze(
    squeezes: int = 100,
    *,
    depth: float = 0.15,
    counts: int = 6,
    speed: float = 0.2,
    spacing: float = 0.005,
    material: Material | None = None,
    settings: Settings | None = None,
) -> Squeeze:
    """Squeeze a floating block between two plates, along each axis in turn.

    The plates close until they are nearer by ``depth`` than the block was thick, open, and the
    next two close along the next axis: so every squeeze has something to squeeze.

    Args:
        squeezes: How many.
        depth: How much thinner the block becomes each time.
        counts: Particles along each edge.
        speed: Of each plate [m/s].
        spacing: Particle spacing [m].
        material: The clay.
        settings: Of the solver.
    """
    scene = Scene(spacing, gravity=(0, 0, 0))
    edge = counts * spacing
    points = block(counts, spacing, (0, 0, -0.5 * edge))
    points += np.random.default_rng(3).uniform(-0.05, 0.05, points.shape) * spacing
    scene.add_clay(points, material or Material())
    plates = []
    for axis in range(3):
        size = np.full(3, 3 * edge)
        size[axis] = 0.02
        box = trimesh.creation.box(size)
        plates += [scene.add_mesh(box.vertices, box.faces, friction=0.3) for _ in range(2)]

    def place(axis: int, low: float, high: float) -> None:
        for plate, offset in zip(plates[2 * axis :], (low - 0.01, high + 0.01), strict=False):
            middle = np.zeros(3)
            middle[axis] = offset
            plate.set_pose(at(*middle))

    def extent(axis: int) -> tuple[float, float]:
        along = solver.positions()[:, axis]
        return float(along.min()) - 0.5 * spacing, float(along.max()) + 0.5 * spacing

    for axis in range(3):
        place(axis, -1.0, 1.0)
    solver = Solver(scene, settings)
    solver.begin()
    for _ in range(10):
        solver.step(1 / 60)
    before = solver.diagnostics().volume_error
    volume, density = surface_volume(solver.positions(), spacing), _density(points, spacing)
    shortening = 0.0
    for number in range(squeezes):
        axis = number % 3
        low, high = extent(axis)
        travel, way = 0.5 * depth * (high - low), 0.0
        margin = 0.05 * spacing
        place(axis, low - margin, high + margin)
        solver.step(1 / 60)
        while way < travel:
            way = min(way + speed / 60, travel)
            place(axis, low + way, high - way)
            solver.step(1 / 60)
        squeezed = extent(axis)
        shortening = 1 - (squeezed[1] - squeezed[0]) / (high - low)
        for opened in (0.5, 1.0):
            place(axis, low - opened * spacing, high + opened * spacing)
            solver.step(1 / 60)
        place(axis, -1.0, 1.0)
    for _ in range(30):
        solver.step(1 / 60)
    after = solver.positions()
    return Squeeze(
        squeezes=squeezes,
        compression_change=solver.diagnostics().volume_error - before,
        surface_change=surface_volume(after, spacing) / volume - 1,
        density_change=_density(after, spacing) / density - 1,
        pieces=len(pieces(after, spacing)),
        shortening=shortening,
    )


def surface_volume(points: NDArray[np.floating], spacing: float) -> float:
    """Volume inside the surface that particles stand for [m³]."""
    # In units of the spacing; the library measures lengths in particle radii, half of it.
    result, _ = pysplashsurf.reconstruction_pipeline(
        np.asarray(points / spacing, np.float64),
        particle_radius=0.5,
        rest_density=1.0,
        smoothing_length=2.0,
        cube_size=0.5,
        iso_surface_threshold=0.55,
    )
    surface: Any = result.mesh if isinstance(result, pysplashsurf.MeshWithData) else result
    return spacing**3 * mesh_volume(np.array(surface.vertices), np.array(surface.triangles))


def _density(points: NDArray[np.floating], spacing: float) -> float:
    """Density of the inner two thirds of the particles, kernel-weighted, over an arbitrary one."""
    apart = np.linalg.norm(points[:, None] - points[None], axis=-1) / (3 * spacing)
    weights = (np.maximum(1 - apart, 0) ** 3).sum(1)
    return float(np.sort(weights)[len(points) // 3 :].mean())
