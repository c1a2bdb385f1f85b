# SPDX-License-Identifier: GPL-3.0-or-later
"""Two blocks pressed into one, and split again by a knife."""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from tactile_clay.solver import Material, Scene, Settings, Solver

from .pieces import pieces
from .shapes import at, block


@dataclass(frozen=True)
class Cut:
    """The outcome of cutting the piece that two blocks had merged into."""

    pieces_before: int
    """Pieces once the blocks were pressed together: 1."""
    pieces_after: int
    """Pieces of at least a twentieth of the clay after the knife is removed: 2."""
    debris: int
    """Number of particles outside those pieces."""
    evenness: float
    """The smaller of the two largest pieces over the larger."""
    gap: float
    """Increase of the distance between the halves' centers when one was pushed aside [m]."""
    push: float
    """How far the knife pushed one half [m]."""
    pulled_along: float
    """How far the other half was dragged along [m]."""


def cut(
    *,
    counts: tuple[int, int, int] = (6, 6, 6),
    thickness: float = 1.0,
    press_depth: float = 0.005,
    speed: float = 0.1,
    push: float = 0.02,
    spacing: float = 0.005,
    material: Material | None = None,
    settings: Settings | None = None,
) -> Cut:
    """Press two blocks together, drive a knife down the joint, and push one half away.

    Args:
        counts: Particles of each block along each axis.
        thickness: Thickness of the blade, in spacings; it tapers to its edge over one spacing,
            which goes into the table.
        press_depth: How far the two are pressed together [m].
        speed: Speed of plates and knife [m/s].
        push: How far the knife then moves sideways [m].
        spacing: Particle spacing [m].
        material: The clay.
        settings: Solver settings.
    """
    size = np.array(counts) * spacing
    apart = 0.8 * spacing
    scene = Scene(spacing)
    half = 0.5 * (size[0] + apart)
    for side in (-1, 1):
        points = block(counts, spacing, (side * half, 0.15 * side * spacing, 0))
        scene.add_clay(points, material or Material())
    scene.add_plane(friction=1.0)
    plate_box = trimesh.creation.box((0.02, 3 * size[1], 3 * size[2]))
    plates = [scene.add_mesh(plate_box.vertices, plate_box.faces, friction=0.0) for _ in range(2)]
    blade = scene.add_mesh(
        *_blade(thickness * spacing, spacing, 3 * size[1], 2.5 * size[2]), friction=0.0
    )

    def place_plates(away: float) -> None:
        for plate, side in zip(plates, (-1, 1), strict=True):
            plate.set_pose(at(side * (away + 0.01), 0, size[2]))

    away = half + 0.5 * size[0]
    closed = away - 0.5 * (apart + press_depth)
    place_plates(away)
    lifted = 1.2 * size[2]
    blade.set_pose(at(0, 0, lifted))
    solver = Solver(scene, settings)
    solver.begin()
    for _ in range(6):
        solver.step(1 / 60)
    while away > closed:
        away = max(away - speed / 60, closed)
        place_plates(away)
        solver.step(1 / 60)
    for _ in range(10):
        away += speed / 60
        place_plates(away)
        solver.step(1 / 60)
    before = len(pieces(solver.positions(), spacing))
    place_plates(1.0)
    height = lifted
    while height > -spacing:
        height = max(height - speed / 60, -spacing)
        blade.set_pose(at(0, 0, height))
        solver.step(1 / 60)
    first = solver.positions()[:, 0] < 0
    start = _middle(solver, first)
    apart_before = _middle(solver, ~first) - start
    moved = 0.0
    while moved < push:
        moved = min(moved + speed / 60, push)
        blade.set_pose(at(moved, 0, height))
        solver.step(1 / 60)
    came = _middle(solver, first) - start
    opened = _middle(solver, ~first) - _middle(solver, first) - apart_before
    while height < lifted:
        height += 2 * speed / 60
        blade.set_pose(at(moved, 0, height))
        solver.step(1 / 60)
    for _ in range(10):
        solver.step(1 / 60)
    found = pieces(solver.positions(), spacing)
    whole = [piece for piece in found if len(piece) >= 0.05 * len(first)]
    return Cut(
        pieces_before=before,
        pieces_after=len(whole),
        debris=len(first) - sum(len(piece) for piece in whole),
        evenness=len(found[1]) / len(found[0]) if len(found) > 1 else 0.0,
        gap=opened,
        push=push,
        pulled_along=came,
    )


def _middle(solver: Solver, chosen: NDArray[np.bool_]) -> float:
    return float(solver.positions()[chosen, 0].mean())


def _blade(
    thickness: float, edge: float, width: float, height: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """A closed blade with its edge along y at the origin: a wedge, then constant thickness."""
    outline = np.array(
        [
            (0.0, 0.0),
            (0.5 * thickness, edge),
            (0.5 * thickness, height),
            (-0.5 * thickness, height),
            (-0.5 * thickness, edge),
        ]
    )
    front = np.column_stack([outline[:, 0], np.full(5, -0.5 * width), outline[:, 1]])
    back = front + np.array((0, width, 0))
    caps = [(0, k, k + 1) for k in range(1, 4)]
    faces = [*caps, *((a + 5, c + 5, b + 5) for a, b, c in caps)]
    for k in range(5):
        following = (k + 1) % 5
        faces += [(k, k + 5, following), (following, k + 5, following + 5)]
    return np.concatenate([front, back]), np.array(faces)
