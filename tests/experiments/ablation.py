# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's ablation (figure 2): a block dropped on an incline, leaving out constraints in turn.

Barreiro, Torres and Otaduy, WHC 2021: the full model absorbs the impact and stops; without
viscosity it flows fast and fractures; without elastoplasticity it drifts; without friction it
slides.
"""

import math
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from tactile_clay.solver import Material, Scene, Settings, Solver

from .shapes import block, turned

GRAVITY = 9.81
ANGLE = math.radians(20)
"""Angle of the incline [rad]."""
SPACING = 0.005
COUNTS = (12, 8, 5)
FALL = 0.1
"""Distance between the block's lowest corner and the incline [m]."""
FRICTION = 0.7
PIECE_REACH = 1.5
"""Particles closer than this belong to one piece, in spacings."""

VARIANTS = MappingProxyType(
    {
        "full": {},
        "without viscosity": {"viscosity": False},
        "without elastoplasticity": {"elastoplasticity": False},
        "without friction": {"friction": False},
    }
)
"""The settings that each variant turns off."""


@dataclass(frozen=True)
class Ablation:
    """The outcome of a block's fall on an incline."""

    variant: str
    """One of `VARIANTS`."""
    pieces: int
    """Number of connected pieces at the end."""
    largest_piece: float
    """Fraction of the particles in the largest piece at the end."""
    height: float
    """Height of the block normal to the incline at the end, over that before the fall."""
    slide: float
    """Motion of the block's center in the last 0.4 s [m]."""
    creep: float
    """RMS motion of particles in the last 0.4 s, without the block's rigid motion [m]."""
    frames: tuple[NDArray[np.float32], ...]
    """Positions at the requested times [m], shape [N, 3] each."""


def drop_on_incline(
    variant: str,
    *,
    model: str = "paper",
    duration: float = 1.2,
    times: tuple[float, ...] = (),
    material: Material | None = None,
) -> Ablation:
    """Drop a level block on an incline, with gravity tilted instead of the incline.

    Args:
        variant: One of `VARIANTS`.
        model: Clay model.
        duration: Duration of the whole experiment [s].
        times: When to keep positions [s].
        material: The clay; by default the default material with the friction of the incline.
    """
    downhill = np.array((math.sin(ANGLE), 0.0, -math.cos(ANGLE)))
    points = turned(block(COUNTS, SPACING), -ANGLE)
    points[:, 2] += 0.5 * SPACING - points[:, 2].min()
    height = float(np.ptp(points[:, 2]))
    points -= FALL * downhill
    scene = Scene(SPACING, tuple(GRAVITY * downhill))
    scene.add_clay(points, material or Material(friction=FRICTION))
    scene.add_plane(friction=FRICTION)
    solver = Solver(scene, Settings(model=model, **VARIANTS[variant]))
    kept: dict[int, NDArray[np.float32]] = {}
    wanted = [round(60 * time) for time in times]
    steps = round(60 * duration)
    for step in range(max([steps, *wanted]) + 1):
        if step in wanted:
            kept[step] = solver.positions()
        if step == steps - 24:
            before = solver.positions().astype(float)
        if step == steps:
            after = solver.positions().astype(float)
        solver.step(1 / 60)
    sizes = piece_sizes(after, PIECE_REACH * SPACING)
    return Ablation(
        variant=variant,
        pieces=len(sizes),
        largest_piece=float(sizes.max() / len(after)),
        height=float(np.ptp(after[:, 2]) / height),
        slide=float(np.linalg.norm((after - before).mean(0))),
        creep=creep_between(before, after),
        frames=tuple(kept[step] for step in wanted),
    )


def piece_sizes(points: NDArray[np.float64], reach: float) -> NDArray[np.int64]:
    """Number of particles in each connected piece, connecting those within reach."""
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    near = apart < reach
    label = np.arange(len(points))
    while True:
        lowest = np.where(near, label[None], len(points)).min(1)
        if np.array_equal(lowest, label):
            return np.unique(label, return_counts=True)[1]
        label = lowest


def creep_between(before: NDArray[np.float64], after: NDArray[np.float64]) -> float:
    """RMS of a motion without its best-fitting rigid part [m] (Kabsch, 1976)."""
    start, end = before - before.mean(0), after - after.mean(0)
    left, _, right = np.linalg.svd(start.T @ end)
    mirror = np.diag((1.0, 1.0, np.linalg.det(left @ right)))
    rest = end - start @ left @ mirror @ right
    return float(np.sqrt((rest**2).sum(1).mean()))
