# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a ray meets the surface of clay that is only known by its particles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

COVER = 0.75
"""Radius of the ball around a particle that stops a ray [spacings].

No ray slips between the particles of a cubic lattice at 0.71, of a disordered one slightly more.
"""
SKIN = 0.5
"""How far the surface lies outside the centers of the outermost particles [spacings]."""
MIN_REACH = 2.5
"""Normals and levels are averaged over at least this radius [spacings]."""


@dataclass(frozen=True)
class SurfaceHit:
    """A point of the clay's surface."""

    point: NDArray[np.float64]
    """Where the ray meets the surface [m], shape [3]."""
    normal: NDArray[np.float64]
    """Unit normal out of the clay, averaged over the radius asked for, shape [3]."""
    distance: float
    """From the ray's origin [m]."""


class ParticleSurface:
    """The surface of a piece of clay at one moment.

    A ray stops at the first ball of `COVER` spacings around a particle. There the normal is the
    gradient of the particles' density, smoothed by a kernel of the radius asked for, and the
    surface lies `SKIN` spacings outside the outermost particles nearby. A ray costs one pass over
    the particles, and the rest of the work is with the few that lie in a slab around the ray.

    Args:
        positions: Particle positions [m], shape [N, 3]. They are not copied.
        spacing: Distance between neighboring particles [m].

    Raises:
        ValueError: The positions have another shape, or the spacing is not positive.
    """

    def __init__(self, positions: ArrayLike, spacing: float) -> None:
        self.positions = np.asarray(positions, np.float32)
        if self.positions.ndim != 2 or self.positions.shape[1] != 3:
            raise ValueError(f"Positions have shape {self.positions.shape}; expected (N, 3).")
        if not (np.isfinite(spacing) and spacing > 0.0):
            raise ValueError(f"The particle spacing is {spacing!r} m; it must be above 0.")
        self.spacing = float(spacing)

    def hit(
        self, origin: ArrayLike, direction: ArrayLike, radius: float, *, level: bool = False
    ) -> SurfaceHit | None:
        """The first point of the surface on a ray.

        Args:
            origin: Where the ray starts [m], shape [3].
            direction: Where it goes, of any length, shape [3].
            radius: What the normal is averaged over [m].
            level: Low-pass the surface itself too: the point lies on the plane that fits the
                surface best within the radius, so that bumps smaller than that vanish.

        Returns:
            The hit; None where the ray misses the clay, or where it has no particles.
        """
        start = np.asarray(origin, np.float64)
        way = np.asarray(direction, np.float64)
        way = way / np.linalg.norm(way)
        reach = max(radius, MIN_REACH * self.spacing)
        near = self._slab(start, way, max(reach, COVER * self.spacing))
        along = (near - start) @ way
        beside = np.linalg.norm(near - start - along[:, None] * way, axis=1)
        cover = COVER * self.spacing
        stops = (beside < cover) & (along > 0.0)
        if not stops.any():
            return None
        first = float((along[stops] - np.sqrt(cover**2 - beside[stops] ** 2)).min())
        touched = start + first * way
        around = near[np.einsum("ij,ij->i", near - touched, near - touched) < reach**2]
        normal = self._normal(touched, around, reach, way)
        if level:
            touched, normal = self._level(touched, normal, around, way)
            slope = min(float(normal @ way), -0.2)
            distance = first + float(normal @ (touched - start - first * way)) / slope
        else:
            distance = first + self._lift(touched, normal, around, way)
        return SurfaceHit(start + distance * way, normal, distance)

    def height_above(
        self, point: ArrayLike, normal: ArrayLike, radius: float, most: float
    ) -> float:
        """How far clay reaches up around a normal, beginning at a point of the surface [m].

        Args:
            point: Where the normal starts [m], shape [3].
            normal: Unit vector, shape [3].
            radius: Clay farther from the normal than this does not count [m].
            most: Nor does clay higher than this [m].

        Returns:
            Height of the highest particle that counts, or 0.
        """
        start, way = np.asarray(point, np.float64), np.asarray(normal, np.float64)
        near = self._slab(start, way, radius) - start
        height = near @ way
        beside = np.einsum("ij,ij->i", near, near) - height**2
        counted = height[(beside < radius**2) & (height > 0.0) & (height < most)]
        return float(counted.max()) + SKIN * self.spacing if len(counted) else 0.0

    def nearest_distance(self, origin: ArrayLike, direction: ArrayLike) -> float | None:
        """Distance along a ray to the point closest to any particle [m]; None if all are behind it.

        Args:
            origin: Where the ray starts [m], shape [3].
            direction: Unit vector, shape [3].
        """
        away = self.positions - np.asarray(origin, np.float32)
        along = away @ np.asarray(direction, np.float32)
        beside = np.einsum("ij,ij->i", away, away) - along**2
        beside[along <= 0.0] = np.inf
        if not len(beside) or not np.isfinite(beside.min()):
            return None
        return float(along[beside.argmin()])

    def _slab(
        self, start: NDArray[np.float64], way: NDArray[np.float64], reach: float
    ) -> NDArray[np.float64]:
        """Particles within some reach of a plane through a line, shape [M, 3]."""
        side = np.cross(np.eye(3)[np.argmin(np.abs(way))], way)
        side /= np.linalg.norm(side)
        # One product with a vector is the only pass over all particles.
        offset = self.positions @ side.astype(np.float32)
        offset -= np.float32(side @ start)
        return self.positions[np.abs(offset) < np.float32(reach)].astype(np.float64)

    def _normal(
        self,
        point: NDArray[np.float64],
        around: NDArray[np.float64],
        reach: float,
        way: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Direction in which the clay thins out fastest, turned to face the viewer."""
        away = point - around
        weight = (1.0 - np.einsum("ij,ij->i", away, away) / reach**2) ** 2
        normal = weight @ away
        normal -= max(float(normal @ way), 0.0) * way
        size = np.linalg.norm(normal)
        return normal / size if size > 1e-6 * reach * len(around) else -way

    def _lift(
        self,
        point: NDArray[np.float64],
        normal: NDArray[np.float64],
        around: NDArray[np.float64],
        way: NDArray[np.float64],
    ) -> float:
        """Distance along the ray from the ball that was hit to the surface [m].

        Balls make a bumpy surface. A smooth maximum of the particles' heights makes it a plane
        over a lattice's layer, whichever gap the ray fell in.
        """
        away = around - point
        height = away @ normal
        beside = np.einsum("ij,ij->i", away, away) - height**2
        patch = height[beside < (1.3 * self.spacing) ** 2]
        weight = np.exp(8.0 * (patch - patch.max()) / self.spacing)
        top = float(weight @ patch / weight.sum()) + SKIN * self.spacing
        slope = min(float(normal @ way), -0.2)
        return float(np.clip(top / slope, -1.5 * self.spacing, 1.5 * self.spacing))

    def _level(
        self,
        point: NDArray[np.float64],
        normal: NDArray[np.float64],
        around: NDArray[np.float64],
        way: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Point and normal of the plane that best fits the surface nearby."""
        seed = np.eye(3)[np.argmin(np.abs(normal))]
        right = np.cross(seed, normal)
        right /= np.linalg.norm(right)
        up = np.cross(normal, right)
        away = around - point
        height = away @ normal
        flat = np.column_stack((away @ right, away @ up))
        # The highest particle of each cell is on the surface; those far below are on another side.
        cells = np.floor(flat / self.spacing).astype(np.int64)
        cells -= cells.min(0)
        key = cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1]
        order = np.lexsort((-height, key))
        top = order[np.unique(key[order], return_index=True)[1]]
        top = top[height[top] > height[top].max() - 0.7 * np.ptp(flat[:, 0])]
        if len(top) < 6:
            return point, normal
        columns = np.column_stack((np.ones(len(top)), flat[top]))
        base, slope_right, slope_up = np.linalg.lstsq(columns, height[top], rcond=None)[0]
        fitted = normal - slope_right * right - slope_up * up
        fitted /= np.linalg.norm(fitted)
        if fitted @ way > 0.0:
            fitted = normal
        return point + (base + SKIN * self.spacing) * normal, fitted
