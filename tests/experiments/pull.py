# SPDX-License-Identifier: GPL-3.0-or-later
"""A bar gripped by jaws at both ends and drawn out until it breaks."""

from dataclasses import dataclass, replace

import numpy as np
import trimesh

from tactile_clay.solver import Material, Scene, Settings, Solver

from .pieces import pieces
from .shapes import at, block


@dataclass(frozen=True)
class Pull:
    """How the bar drew out, and the pieces that it broke into."""

    stretch: float
    """Free length between the jaws when the bar broke, over that at the start."""
    drawn: float
    """Elongation of the bar when it broke, over its thickness: about 1 for an ideally plastic bar,
    which necks to a point between two slip lines at 45°."""
    neck: float
    """Smallest cross-section just before breaking, over that at the start."""
    piece_count: int
    """Number of pieces of at least a twentieth of the clay."""
    debris: int
    """Number of particles outside those pieces."""
    evenness: float
    """The smaller of the two largest pieces over the larger."""
    force_ratio: float
    """Largest pull on a pair of jaws over √3 τ_y A, the strength of a plastic bar."""


def pull(
    *,
    width: int = 6,
    free: int = 12,
    held: int = 5,
    spacing: float = 0.005,
    speed: float = 0.05,
    jitter: float = 0.2,
    max_stretch: float = 4.0,
    material: Material | None = None,
    settings: Settings | None = None,
) -> Pull:
    """Grip a bar at both ends and pull, without gravity.

    The clay in the jaws yields at twenty times the stress, so that the free length breaks and not
    the grip.

    Args:
        width: Number of particles across the bar.
        free: Number of particles along the free length.
        held: Number of particles along each end in the jaws.
        spacing: Particle spacing [m].
        speed: Speed of each end [m/s].
        jitter: Largest random offset of the particles, in spacings.
        max_stretch: Stretch at which to give up.
        material: The clay.
        settings: Solver settings.
    """
    material = material or Material()
    thickness, free_length = width * spacing, free * spacing
    points = block((free + 2 * held, width, width), spacing, (0, 0, -0.5 * thickness))
    points += np.random.default_rng(1).uniform(-jitter, jitter, points.shape) * spacing
    scene = Scene(spacing, gravity=(0, 0, 0))
    gripped = np.abs(points[:, 0]) > 0.5 * free_length
    scene.add_clay(points[~gripped], material)
    scene.add_clay(points[gripped], replace(material, yield_stress=20 * material.yield_stress))
    jaw_size = (held * spacing, 2 * thickness, 0.02)
    jaw_box = trimesh.creation.box(jaw_size)
    sides = [(end, face) for end in (-1, 1) for face in (-1, 1)]
    jaws = [scene.add_mesh(jaw_box.vertices, jaw_box.faces, friction=20.0) for _ in sides]

    def place(gap: float, apart: float) -> None:
        """Put the jaws ``gap`` from the bar's faces, and ``apart`` farther out [m]."""
        for jaw, (end, face) in zip(jaws, sides, strict=True):
            along = end * (0.5 * (free_length + jaw_size[0]) + apart)
            jaw.set_pose(at(along, 0.0, face * (0.5 * thickness + gap + 0.01)))

    gap = 0.2 * spacing
    place(gap, 0.0)
    solver = Solver(scene, settings)
    solver.begin()
    grip = -0.06 * thickness
    while gap > grip:
        gap = max(gap - 0.06 / 60, grip)
        place(gap, 0.0)
        solver.step(1 / 60)
    for _ in range(6):
        solver.step(1 / 60)
    apart, neck, strongest = 0.0, 1.0, 0.0
    clay = pieces(solver.positions(), spacing)
    while len(clay[0]) > 0.9 * len(points) and 1 + 2 * apart / free_length < max_stretch:
        neck = _neck(solver.positions(), spacing) / width**2
        apart += speed / 60
        place(gap, apart)
        solver.step(1 / 60)
        strongest = max(strongest, float(sum(solver.force_on(jaw)[0] for jaw in jaws[:2])))
        clay = pieces(solver.positions(), spacing)
    parted = apart
    for _ in range(20):
        apart += speed / 60
        place(gap, apart)
        solver.step(1 / 60)
    clay = pieces(solver.positions(), spacing)
    whole = [piece for piece in clay if len(piece) >= 0.05 * len(points)]
    return Pull(
        stretch=1 + 2 * parted / free_length,
        drawn=2 * parted / thickness,
        neck=neck,
        piece_count=len(whole),
        debris=len(points) - sum(len(piece) for piece in whole),
        evenness=len(clay[1]) / len(clay[0]) if len(clay) > 1 else 0.0,
        force_ratio=strongest / (3**0.5 * material.yield_stress * thickness**2),
    )


def _neck(points: np.ndarray, spacing: float) -> float:
    """Smallest number of particles in a slice of two spacings between the ends, halved."""
    x = np.sort(points[:, 0])
    inner = np.arange(x[0] + 4 * spacing, x[-1] - 4 * spacing, 0.5 * spacing)
    counts = np.searchsorted(x, inner + spacing) - np.searchsorted(x, inner - spacing)
    return float(counts.min()) / 2
