# SPDX-License-Identifier: GPL-3.0-or-later
"""Free fall, and the impulse with which a table stops a falling block."""

from dataclasses import dataclass

from tactile_clay.solver import Material, Scene, Settings, Solver

from .shapes import block

GRAVITY = 9.81


@dataclass(frozen=True)
class FreeFall:
    """Distance fallen from rest."""

    fallen: float
    """Distance fallen [m]."""
    expected: float
    """½ g t² [m]."""
    distortion: float
    """Largest displacement of a particle within the block [m]."""


def free_fall(duration: float = 0.5, *, settings: Settings | None = None) -> FreeFall:
    """Drop a block with nothing below."""
    scene = Scene(0.005)
    scene.add_clay(block(5, 0.005), Material())
    solver = Solver(scene, settings)
    before = solver.positions().astype(float)
    for _ in range(round(duration * 60)):
        solver.step(1 / 60)
    moved = solver.positions() - before
    return FreeFall(
        fallen=float(-moved[:, 2].mean()),
        expected=0.5 * GRAVITY * duration**2,
        distortion=float(abs(moved - moved.mean(0)).max()),
    )


@dataclass(frozen=True)
class Drop:
    """A block stopped by a table."""

    impulse_ratio: float
    """Impulse of the table over m g t: 1 once the block rests."""
    final_weight: float
    """Force on the table at the end over m g."""
    height_ratio: float
    """Height of the block at the end over its height before."""


def drop(
    height: float = 0.05,
    *,
    counts: int = 7,
    duration: float = 1.0,
    settings: Settings | None = None,
) -> Drop:
    """Let a block fall on a table and come to rest."""
    spacing = 0.005
    material = Material()
    scene = Scene(spacing)
    scene.add_clay(block(counts, spacing, (0, 0, height)), material)
    table = scene.add_plane()
    solver = Solver(scene, settings)
    weight = counts**3 * material.density * spacing**3 * GRAVITY
    impulse = 0.0
    steps = round(duration * 60)
    for _ in range(steps):
        solver.step(1 / 60)
        impulse -= solver.force_on(table)[2] / 60
    return Drop(
        impulse_ratio=impulse / (weight * steps / 60),
        final_weight=float(-solver.force_on(table)[2] / weight),
        height_ratio=float((solver.positions()[:, 2].max() + spacing / 2) / (counts * spacing)),
    )
