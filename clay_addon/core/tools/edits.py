# SPDX-License-Identifier: GPL-3.0-or-later
"""Changes of the clay without touch: adding, removing and painting particles.

An edit is in meters, so it means the same for any spacing of the clay.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

EditKind = Literal["add", "remove", "paint"]

MIN_DISTANCE = 0.8
"""Least distance of new particles from existing ones [spacings]: closer, they push them away."""


@dataclass(frozen=True)
class Edit:
    """One dab of a brush: a change inside a sphere."""

    kind: EditKind
    """``add`` fills the sphere with clay, ``remove`` empties it, ``paint`` colors it."""
    center: tuple[float, float, float]
    """Of the sphere, in the world [m]."""
    radius: float
    """Of the sphere [m]."""
    strength: float = 1.0
    """Of paint, 0 to 1: share of the new color at the center."""
    color: tuple[float, float, float, float] = (0.72, 0.36, 0.22, 1.0)
    """Of paint and of new clay, linear RGBA."""

    def __post_init__(self) -> None:
        if self.kind not in ("add", "remove", "paint"):
            raise ValueError(f"There is no edit {self.kind!r}. There are: add, remove, paint.")
        numbers = (*self.center, self.radius, self.strength, *self.color)
        if len(self.center) != 3 or len(self.color) != 4 or not np.isfinite(numbers).all():
            raise ValueError("An edit needs three finite coordinates and four of a color.")
        if self.radius <= 0.0:
            raise ValueError(f"The radius of an edit is {self.radius!r} m; it must be above 0.")
        if not 0.0 <= self.strength <= 1.0:
            raise ValueError(f"The strength of an edit is {self.strength!r}; it must be 0 to 1.")


@dataclass(frozen=True)
class EditResult:
    """The clay after an edit. Particles that were there come first, in their order."""

    positions: NDArray[np.float32]
    """Particle positions [m], shape [M, 3]."""
    colors: NDArray[np.float32]
    """Linear RGBA, shape [M, 4]."""
    kept: NDArray[np.int64]
    """Index of each particle before the edit, or -1 for a new one, shape [M]."""

    @property
    def moves_particles(self) -> bool:
        """Whether particles came or went, and not only colors changed."""
        return bool(len(self.kept) and self.kept[-1] < 0) or self._fewer

    _fewer: bool = False


def apply_edit(edit: Edit, positions: ArrayLike, colors: ArrayLike, spacing: float) -> EditResult:
    """Carry an edit out.

    Args:
        edit: What to do.
        positions: Particle positions in the world [m], shape [N, 3].
        colors: Their linear RGBA, shape [N, 4].
        spacing: Distance of neighboring particles [m].

    Raises:
        ValueError: The shapes do not fit, or the spacing is not positive.
    """
    points = np.asarray(positions, np.float32)
    paints = np.asarray(colors, np.float32)
    if points.ndim != 2 or points.shape[1] != 3 or paints.shape != (len(points), 4):
        raise ValueError(
            f"Positions have shape {points.shape} and colors {paints.shape}; expected (N, 3) "
            "and (N, 4)."
        )
    if not (np.isfinite(spacing) and spacing > 0.0):
        raise ValueError(f"The particle spacing is {spacing!r} m; it must be above 0.")
    color = np.array(edit.color, np.float32)
    everything = np.arange(len(points))
    center = np.asarray(edit.center, np.float64)
    if edit.kind == "add":
        new = _new_points(center, edit.radius, points, spacing)
        return EditResult(
            np.concatenate((points, new)),
            np.concatenate((paints, np.tile(color, (len(new), 1)))),
            np.concatenate((everything, np.full(len(new), -1))),
        )
    distance = np.linalg.norm(points - center, axis=1)
    if edit.kind == "remove":
        kept = everything[distance >= edit.radius]
        return EditResult(points[kept], paints[kept], kept, len(kept) < len(points))
    weight = edit.strength * fall_off(distance / edit.radius)[:, None]
    blended = paints + weight.astype(np.float32) * (color - paints)
    return EditResult(points, blended, everything)


def fall_off(fraction: NDArray[np.floating]) -> NDArray[np.float64]:
    """How much of an edit arrives at a fraction of its radius: 1 in the middle, 0 from the rim.

    Half of the radius keeps nearly all, and both ends are smooth (Hermite's cubic).
    """
    inside = 1.0 - np.clip(np.asarray(fraction, np.float64), 0.0, 1.0)
    rising = np.clip(1.6 * inside, 0.0, 1.0)
    return rising * rising * (3.0 - 2.0 * rising)


def _new_points(
    center: NDArray[np.float64], radius: float, points: NDArray[np.float32], spacing: float
) -> NDArray[np.float32]:
    """Points inside a sphere of a lattice fixed in the world, away from existing particles [m].

    The lattice is the same for all edits, so that dabs that overlap fit together.
    """
    low = np.ceil((center - radius) / spacing).astype(np.int64)
    high = np.floor((center + radius) / spacing).astype(np.int64)
    axes = [np.arange(a, b + 1) * spacing for a, b in zip(low, high, strict=True)]
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    lattice = lattice[np.linalg.norm(lattice - center, axis=1) < radius]
    near = points[(np.abs(points - center) < radius + spacing).all(1)].astype(np.float64)
    free = _nearest_distance(lattice, near, spacing) >= MIN_DISTANCE * spacing
    return lattice[free].astype(np.float32)


def _nearest_distance(
    points: NDArray[np.float64], others: NDArray[np.float64], reach: float
) -> NDArray[np.float64]:
    """Distance to the nearest of some others [m], where that is less than a reach; shape [N]."""
    nearest = np.full(len(points), np.inf)
    if not len(points) or not len(others):
        return nearest
    low = np.minimum(points.min(0), others.min(0)) - reach
    cells = np.floor((others - low) / reach).astype(np.int64)
    size = np.maximum(cells.max(0), np.floor((points.max(0) - low) / reach).astype(np.int64)) + 2
    key = (cells[:, 0] * size[1] + cells[:, 1]) * size[2] + cells[:, 2]
    order = np.argsort(key, kind="stable")
    key, others = key[order], others[order]
    home = np.floor((points - low) / reach).astype(np.int64)
    for shift in np.ndindex(3, 3, 3):
        cell = home + np.array(shift) - 1
        wanted = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
        first = np.searchsorted(key, wanted, "left")
        last = np.searchsorted(key, wanted, "right")
        for offset in range(int((last - first).max(initial=0))):
            here = np.flatnonzero(first + offset < last)
            distance = np.linalg.norm(points[here] - others[first[here] + offset], axis=1)
            nearest[here] = np.minimum(nearest[here], distance)
    return nearest
