# SPDX-License-Identifier: GPL-3.0-or-later
"""A block kneaded between plates a hundred times, to check that it keeps its volume."""

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
    """The changes of a block in many squeezes."""

    squeezes: int
    """Number of squeezes."""
    compression_change: float
    """Change of the mean compression at rest."""
    surface_change: float
    """Relative change of the volume inside the reconstructed surface."""
    density_change: float
    """Relative change of the kernel-weighted density of inner particles."""
    pieces: int
    """Number of pieces at the end."""
    shortening: float
    """Relative reduction of the thickness in the last squeeze."""


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

    The plates close until the block is thinner by ``depth``, open, and the next two close along the
    next axis, so that every squeeze deforms the block.

    Args:
        squeezes: Number of squeezes.
        depth: Relative reduction of the block's thickness in each.
        counts: Number of particles along each edge.
        speed: Speed of each plate [m/s].
        spacing: Particle spacing [m].
        material: The clay.
        settings: Solver settings.
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
        travel, moved = 0.5 * depth * (high - low), 0.0
        margin = 0.05 * spacing
        place(axis, low - margin, high + margin)
        solver.step(1 / 60)
        while moved < travel:
            moved = min(moved + speed / 60, travel)
            place(axis, low + moved, high - moved)
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
    """Volume inside the reconstructed surface of particles [m³]."""
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
    """Kernel-weighted density of the inner two thirds of the particles, in arbitrary units."""
    apart = np.linalg.norm(points[:, None] - points[None], axis=-1) / (3 * spacing)
    weights = (np.maximum(1 - apart, 0) ** 3).sum(1)
    return float(np.sort(weights)[len(points) // 3 :].mean())
