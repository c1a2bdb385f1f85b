# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene that all engines run, and the measurements taken of each in the same way.

A block of clay stands on a table. A ball is pressed into it, held, and taken away. The scene is
passed to an engine as arrays in a file, and so is its result, so that each engine can run in its
own Python environment.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FRAME = 1.0 / 60.0
RADIUS = 0.012
"""Radius of the ball [m]."""
DEPTH = 0.012
"""Depth of the press [m]."""
SPEED = 0.09
"""Speed of the ball [m/s]."""
SETTLING, RESTING, HOLDING, LEAVING = 12, 18, 20, 40
"""Number of frames before and during the measurement of drift, with the ball held, and after."""

MATERIAL = {
    "density": 1700.0,
    "yield_stress": 5e3,
    "shear_modulus": 1e5,
    "bulk_modulus": 3e5,
    "friction": 0.5,
}
"""SI units, yield stress in shear. No viscosity, because slip-line theory has none."""


@dataclass(frozen=True)
class PeerScene:
    """The scene as arrays."""

    points: Array
    """Particles [m], shape [N, 3]."""
    spacing: float
    """Particle spacing [m]."""
    heights: Array
    """Height of the ball's center above the origin at the end of each frame [m], shape [F]."""
    settled: int
    """Frame after which the block has settled."""
    rested: int
    """Frame after which its drift is measured and the press begins."""
    pressed: int
    """Frame after which the ball is deepest."""
    held: int
    """Last frame in which the ball is held."""

    def snapshots(self) -> list[int]:
        """Frames after which positions are recorded."""
        return [self.settled, self.rested, self.held, len(self.heights) - 1]

    def arrays(self) -> dict[str, Any]:
        """The scene as an engine receives it."""
        return {
            "points": self.points,
            "spacing": np.array(self.spacing),
            "heights": self.heights,
            "snapshots": np.array(self.snapshots()),
            "radius": np.array(RADIUS),
            "speed": np.array(SPEED),
            "frame": np.array(FRAME),
            **{name: np.array(value) for name, value in MATERIAL.items()},
        }


def make_scene(counts: int = 16, spacing: float = 0.005) -> PeerScene:
    """Make a cube with ``counts`` particles per side."""
    axis = (np.arange(counts) + 0.5) * spacing
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    points[:, :2] -= 0.5 * counts * spacing
    top = counts * spacing
    away = np.full(SETTLING + RESTING, top + RADIUS + 0.1)
    steps = round(DEPTH / (SPEED * FRAME))
    down = top + RADIUS - np.linspace(0.0, DEPTH, steps + 1)
    held = np.full(HOLDING, down[-1])
    up = down[-1] + 2.0 * SPEED * FRAME * np.arange(1, LEAVING + 1)
    heights = np.concatenate((away, down, held, up))
    rested = SETTLING + RESTING - 1
    pressed = rested + len(down)
    return PeerScene(points, spacing, heights, SETTLING - 1, rested, pressed, pressed + HOLDING)


@dataclass(frozen=True)
class PeerMeasures:
    """The measurements that are compared."""

    drift: float
    """Largest motion of a particle of the settled block in .3 s, over the spacing."""
    force_moving: float
    """Force on the ball at full depth, over the middle of slip-line theory's 5.7 to 6.05 τ_y A; NaN
    if the engine does not report it."""
    force_held: float
    """The same, a third of a second later."""
    dent: float
    """Depth under the held ball, over the depth of the press."""
    spring_back: float
    """Fraction of the dent that sprang back."""
    compression: float
    """Mean change of density at the end, relative to the density at rest."""
    height_lost: float
    """Sinking of the block's upper edges at the end, over its height."""
    core_microseconds: float
    """Processor microseconds per particle and frame: median over the frames of press and hold."""
    wall_milliseconds: float
    """Milliseconds per frame: median over the same frames."""


def measure(scene: PeerScene, result: dict[str, NDArray]) -> PeerMeasures:
    """Measure an engine's result.

    Args:
        scene: The scene that it ran.
        result: ``positions`` [m], shape [S, N, 3], after the frames of `PeerScene.snapshots`;
            ``forces`` upwards on the ball [N], mean over each frame, shape [F]; ``core_seconds``
            and ``wall_seconds`` of each frame, shape [F].
    """
    settled, rested, held, left = result["positions"].astype(float)
    forces = result["forces"]
    spacing = scene.spacing
    area = math.pi * (2.0 * RADIUS * DEPTH - DEPTH**2)
    theory = 0.5 * (5.7 + 6.05) * MATERIAL["yield_stress"] * area
    across = np.hypot(scene.points[:, 0], scene.points[:, 1])
    top = scene.points[:, 2].max()
    under = (across < 1.1 * spacing) & (scene.points[:, 2] > top - 0.5 * spacing)
    edge = (across > across.max() - 2.0 * spacing) & (scene.points[:, 2] > top - 0.5 * spacing)

    def sink(positions: Array, chosen: NDArray[np.bool_]) -> float:
        return float((rested[chosen, 2] - positions[chosen, 2]).mean())

    dent = sink(held, under)
    work = slice(scene.rested + 1, scene.held + 1)
    before, after = mean_density(rested, spacing), mean_density(left, spacing)
    return PeerMeasures(
        drift=float(np.linalg.norm(rested - settled, axis=1).max() / spacing),
        force_moving=float(forces[scene.pressed - 1 : scene.pressed + 1].mean() / theory),
        force_held=float(forces[scene.held - 2 : scene.held + 1].mean() / theory),
        dent=dent / DEPTH,
        spring_back=1.0 - sink(left, under) / dent if dent else math.nan,
        compression=after / before - 1.0,
        height_lost=float((scene.points[edge, 2] - left[edge, 2]).mean() / (top + 0.5 * spacing)),
        core_microseconds=float(1e6 * np.median(result["core_seconds"][work]) / len(scene.points)),
        wall_milliseconds=float(1e3 * np.median(result["wall_seconds"][work])),
    )


def mean_density(positions: Array, spacing: float) -> float:
    """Mean of Σ (1 − r/3d)³ over the particles: nearly proportional to density."""
    total = 0.0
    reach = 3.0 * spacing
    for some in np.array_split(positions, max(1, len(positions) // 256)):
        distance = np.linalg.norm(some[:, None] - positions[None], axis=2)
        total += float((np.maximum(1.0 - distance / reach, 0.0) ** 3).sum())
    return total / len(positions)
