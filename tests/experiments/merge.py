# SPDX-License-Identifier: GPL-3.0-or-later
"""Two blocks pressed together; one is then lifted between two plates."""

from dataclasses import dataclass

import trimesh

from tactile_clay.solver import Material, Scene, Settings, Solver

from .shapes import at, block


@dataclass(frozen=True)
class Merge:
    """How far each block rose with the plates."""

    lift: float
    """Rise of the plates [m]."""
    upper: float
    """Rise of the upper block [m]."""
    lower: float
    """Rise of the lower block [m]."""


def merge(
    press_depth: float = 0.005,
    *,
    counts: int = 7,
    material: Material | None = None,
    settings: Settings | None = None,
) -> Merge:
    """Press the upper block onto the lower, grip the upper one, and lift."""
    material = material or Material()
    spacing, speed = 0.005, 0.06
    size = counts * spacing
    apart = 0.6 * spacing
    scene = Scene(spacing)
    lower = block(counts, spacing)
    upper = block(counts, spacing, (0.3 * spacing, 0.2 * spacing, size + apart))
    scene.add_clay(lower, material)
    scene.add_clay(upper, material)
    scene.add_plane()
    lid_box = trimesh.creation.box((2 * size, 2 * size, 0.02))
    plate_box = trimesh.creation.box((0.02, 2 * size, 0.6 * size))
    lid = scene.add_mesh(lid_box.vertices, lid_box.faces)
    plates = [scene.add_mesh(plate_box.vertices, plate_box.faces, friction=1.0) for _ in range(2)]
    top = 2 * size + apart
    middle = 1.5 * size + apart

    def place_plates(gap: float, height: float) -> None:
        for plate, side in zip(plates, (-1.0, 1.0), strict=True):
            plate.set_pose(at(side * (0.5 * size + gap + 0.01) + 0.3 * spacing, 0.0, height))

    lid_height = top + 0.011
    lid.set_pose(at(0, 0, lid_height))
    place_plates(0.01, middle)
    solver = Solver(scene, settings)
    solver.begin()

    def heights() -> tuple[float, float]:
        z = solver.positions()[:, 2]
        return float(z[: counts**3].mean()), float(z[counts**3 :].mean())

    for _ in range(10):
        solver.step(1 / 60)
    while lid_height > top - apart - press_depth + 0.01:
        lid_height -= speed / 60
        lid.set_pose(at(0, 0, lid_height))
        solver.step(1 / 60)
    for _ in range(6):
        lid_height += 4 * speed / 60
        lid.set_pose(at(0, 0, lid_height))
        solver.step(1 / 60)
    lid.set_pose(at(0, 0, 1.0))
    gap, height = 0.01, heights()[1]
    while gap > -0.004:
        gap -= speed / 60
        place_plates(gap, height)
        solver.step(1 / 60)
    before = heights()
    lift = 0.0
    while lift < 0.02:
        lift += speed / 60
        place_plates(gap, height + lift)
        solver.step(1 / 60)
    for _ in range(10):
        solver.step(1 / 60)
    after = heights()
    return Merge(lift=lift, upper=after[1] - before[1], lower=after[0] - before[0])
