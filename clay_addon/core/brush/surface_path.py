# SPDX-License-Identifier: GPL-3.0-or-later
"""The path of the cursor over the clay as it was at the start of the stroke."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .raycast import ParticleSurface
from .view_ray import Ray, View

_MAX_RAYS = 8
"""Maximum number of rays cast for one motion of the cursor, to limit the time it takes."""
_MIN_PIXELS = 3.0
"""Minimum distance between rays [pixels]; in between, the path is straight."""


@dataclass(frozen=True)
class Waypoint:
    """A point on the path of a tool."""

    point: NDArray[np.float64]
    """Point on the surface, or beside it in a plane parallel to the view [m], shape [3]."""
    normal: NDArray[np.float64]
    """Unit vector away from the clay, shape [3]."""
    on_clay: bool
    """Whether the cursor is on the clay."""
    jump: bool = False
    """Whether there is a gap before this point, so that the tool must be lifted."""


class SurfacePath:
    """Converts positions of the cursor to waypoints of the tool.

    The surface is that of the start, so a tool that stays in place does not dig itself in. Where
    the cursor leaves the clay, the path continues in the plane parallel to the view through the
    last point. Where the cursor crosses an edge to something far behind or in front, it jumps.

    Args:
        surface: The clay's surface at the start of the stroke.
        radius: Radius of the brush [m].
        level: Whether to low-pass the surface.
        flat: Whether to follow the plane parallel to the view through the first point instead.
    """

    def __init__(
        self, surface: ParticleSurface, radius: float, *, level: bool = False, flat: bool = False
    ) -> None:
        self.surface = surface
        self.radius = radius
        self.level = level
        self.flat = flat
        self._last: Waypoint | None = None
        self._pixel = (0.0, 0.0)

    def begin(self, view: View, x: float, y: float) -> Waypoint | None:
        """The first waypoint; None if there is no clay in front of the viewer.

        Args:
            view: The view that the cursor is in.
            x: Cursor's distance from the region's left edge [pixels].
            y: Cursor's distance from the region's lower edge [pixels].
        """
        ray = view.ray(x, y)
        found = self._cast(ray)
        if found is None:
            distance = self.surface.nearest_distance(ray.origin, ray.direction)
            if distance is None:
                return None
            found = Waypoint(ray.at(distance), -ray.direction, False)
        self._last, self._pixel = found, (x, y)
        return found

    def start_at(self, waypoint: Waypoint) -> None:
        """Replace the waypoint found by `begin`, for the same cursor position."""
        self._last = waypoint

    def extend(self, view: View, x: float, y: float) -> list[Waypoint]:
        """The waypoints up to a new position of the cursor.

        Args:
            view: The view that the cursor is in.
            x: Cursor's distance from the region's left edge [pixels].
            y: Cursor's distance from the region's lower edge [pixels].
        """
        assert self._last is not None, "begin comes first"
        distance = math.dist(self._pixel, (x, y))
        if distance < 0.5:
            return []
        pixel = view.pixel(self._last.point)
        step = max(0.5 * self.radius / max(pixel, 1e-12), _MIN_PIXELS)
        count = min(max(math.ceil(distance / step), 1), _MAX_RAYS)
        begin, waypoints = self._pixel, []
        for index in range(1, count + 1):
            part = index / count
            cursor = (begin[0] + part * (x - begin[0]), begin[1] + part * (y - begin[1]))
            waypoints.append(self._follow(view, *cursor, expected=distance / count * pixel))
        self._pixel = (x, y)
        return waypoints

    def _follow(self, view: View, x: float, y: float, expected: float) -> Waypoint:
        last = self._last
        assert last is not None
        ray = view.ray(x, y)
        found = None if self.flat else self._cast(ray)
        if found is None:
            point = ray.intersect_plane(last.point, view.forward)
            found = Waypoint(last.point if point is None else point, last.normal, self.flat)
        else:
            gap = abs(float((found.point - last.point) @ view.forward))
            if gap > max(self.radius + 2.0 * self.surface.spacing, 3.0 * expected):
                found = Waypoint(found.point, found.normal, True, jump=True)
        self._last = found
        return found

    def _cast(self, ray: Ray) -> Waypoint | None:
        hit = self.surface.hit(ray.origin, ray.direction, self.radius, level=self.level)
        return None if hit is None else Waypoint(hit.point, hit.normal, True)
