# SPDX-License-Identifier: GPL-3.0-or-later
"""Ray casting against the surface of clay that is given only by its particles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

COVER = 0.75
"""Radius of the ball around a particle that stops a ray [spacings].

No ray slips between the particles of a cubic lattice at 0.71, of a disordered one slightly more.
"""
SKIN = 0.5
"""Distance of the surface from the centers of the outermost particles [spacings]."""
MIN_REACH = 2.5
"""Minimum radius over which normals and levels are averaged [spacings]."""


@dataclass(frozen=True)
class SurfaceHit:
    """Intersection of a ray with the clay's surface."""

    point: NDArray[np.float64]
    """The point of intersection [m], shape [3]."""
    normal: NDArray[np.float64]
    """Outward unit normal, averaged over the requested radius, shape [3]."""
    distance: float
    """Distance from the ray's origin [m]."""


class ParticleSurface:
    """The surface of a piece of clay at one moment.

    A ray stops at the first ball of `COVER` spacings around a particle. There the normal is the
    negative gradient of the particle density, smoothed by a kernel of the requested radius, and the
    surface is `SKIN` spacings outside the outermost particles nearby. A ray costs one pass over
    all particles; the rest of the work involves only the few in a slab around the ray.

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
        """The first intersection of a ray with the surface.

        Args:
            origin: Start of the ray [m], shape [3].
            direction: Direction of the ray, of any length, shape [3].
            radius: Radius over which the normal is averaged [m].
            level: Whether to low-pass the surface too: the point is then on the plane that best
                fits the surface within the radius, so that smaller bumps vanish.

        Returns:
            The hit; None if the ray misses the clay or there are no particles.
        """
        start = np.asarray(origin, np.float64)
        axis = np.asarray(direction, np.float64)
        axis = axis / np.linalg.norm(axis)
        reach = max(radius, MIN_REACH * self.spacing)
        near = self._slab(start, axis, max(reach, COVER * self.spacing))
        along = (near - start) @ axis
        off_axis = np.linalg.norm(near - start - along[:, None] * axis, axis=1)
        cover = COVER * self.spacing
        stops = (off_axis < cover) & (along > 0.0)
        if not stops.any():
            return None
        first = float((along[stops] - np.sqrt(cover**2 - off_axis[stops] ** 2)).min())
        touched = start + first * axis
        around = near[np.einsum("ij,ij->i", near - touched, near - touched) < reach**2]
        normal = self._normal(touched, around, reach, axis)
        if level:
            touched, normal = self._level(touched, normal, around, axis)
            slope = min(float(normal @ axis), -0.2)
            distance = first + float(normal @ (touched - start - first * axis)) / slope
        else:
            distance = first + self._lift(touched, normal, around, axis)
        return SurfaceHit(start + distance * axis, normal, distance)

    def height_above(
        self, point: ArrayLike, normal: ArrayLike, radius: float, max_height: float
    ) -> float:
        """Height of the clay around a normal, above a point of the surface [m].

        Args:
            point: Point on the surface [m], shape [3].
            normal: Unit vector, shape [3].
            radius: Particles farther from the normal than this are ignored [m].
            max_height: Particles higher than this are ignored [m].

        Returns:
            Height of the surface at the highest particle; 0 if there is none.
        """
        start, axis = np.asarray(point, np.float64), np.asarray(normal, np.float64)
        near = self._slab(start, axis, radius) - start
        height = near @ axis
        off_axis_squared = np.einsum("ij,ij->i", near, near) - height**2
        counted = height[(off_axis_squared < radius**2) & (height > 0.0) & (height < max_height)]
        return float(counted.max()) + SKIN * self.spacing if len(counted) else 0.0

    def nearest_distance(self, origin: ArrayLike, direction: ArrayLike) -> float | None:
        """Distance along a ray to the point closest to any particle [m]; None if all are behind it.

        Args:
            origin: Start of the ray [m], shape [3].
            direction: Unit vector, shape [3].
        """
        away = self.positions - np.asarray(origin, np.float32)
        along = away @ np.asarray(direction, np.float32)
        off_axis_squared = np.einsum("ij,ij->i", away, away) - along**2
        off_axis_squared[along <= 0.0] = np.inf
        if not len(off_axis_squared) or not np.isfinite(off_axis_squared.min()):
            return None
        return float(along[off_axis_squared.argmin()])

    def _slab(
        self, start: NDArray[np.float64], axis: NDArray[np.float64], reach: float
    ) -> NDArray[np.float64]:
        """Particles within some distance of a plane through a line, shape [M, 3]."""
        side = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
        side /= np.linalg.norm(side)
        # This product with a vector is the only pass over all particles.
        offset = self.positions @ side.astype(np.float32)
        offset -= np.float32(side @ start)
        return self.positions[np.abs(offset) < np.float32(reach)].astype(np.float64)

    def _normal(
        self,
        point: NDArray[np.float64],
        around: NDArray[np.float64],
        reach: float,
        axis: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Negative gradient of the particle density, turned to face the viewer."""
        away = point - around
        weight = (1.0 - np.einsum("ij,ij->i", away, away) / reach**2) ** 2
        normal = weight @ away
        normal -= max(float(normal @ axis), 0.0) * axis
        size = np.linalg.norm(normal)
        return normal / size if size > 1e-6 * reach * len(around) else -axis

    def _lift(
        self,
        point: NDArray[np.float64],
        normal: NDArray[np.float64],
        around: NDArray[np.float64],
        axis: NDArray[np.float64],
    ) -> float:
        """Distance along the ray from the hit ball to the surface [m].

        The balls form a bumpy surface. A smooth maximum of the particles' heights makes it a plane
        above a lattice layer, wherever the ray hits.
        """
        away = around - point
        height = away @ normal
        off_axis_squared = np.einsum("ij,ij->i", away, away) - height**2
        patch = height[off_axis_squared < (1.3 * self.spacing) ** 2]
        weight = np.exp(8.0 * (patch - patch.max()) / self.spacing)
        top = float(weight @ patch / weight.sum()) + SKIN * self.spacing
        slope = min(float(normal @ axis), -0.2)
        return float(np.clip(top / slope, -1.5 * self.spacing, 1.5 * self.spacing))

    def _level(
        self,
        point: NDArray[np.float64],
        normal: NDArray[np.float64],
        around: NDArray[np.float64],
        axis: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Point and normal of the plane that best fits the surface nearby."""
        seed = np.eye(3)[np.argmin(np.abs(normal))]
        right = np.cross(seed, normal)
        right /= np.linalg.norm(right)
        up = np.cross(normal, right)
        away = around - point
        height = away @ normal
        flat = np.column_stack((away @ right, away @ up))
        # The highest particle of each cell is on the surface; much lower ones are on another side.
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
        if fitted @ axis > 0.0:
            fitted = normal
        return point + (base + SKIN * self.spacing) * normal, fitted
