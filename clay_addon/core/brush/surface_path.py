# SPDX-License-Identifier: GPL-3.0-or-later
"""The path of the cursor over the clay as it was when the stroke began."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .raycast import ParticleSurface
from .view_ray import Ray, View

_MAX_RAYS = 8
"""Most rays cast for one motion of the cursor, so that none takes long."""
_MIN_PIXELS = 3.0
"""Least distance between rays [pixels]: closer together, the surface counts as straight."""


@dataclass(frozen=True)
class Waypoint:
    """A place for the tool to go to."""

    point: NDArray[np.float64]
    """On the surface, or in the plane of the view beside it [m], shape [3]."""
    normal: NDArray[np.float64]
    """Unit vector away from the clay, shape [3]."""
    on_clay: bool
    """Whether the cursor is on the clay."""
    jump: bool = False
    """Whether there is a gap before it, so that the tool must be lifted."""


class SurfacePath:
    """Turns places of the cursor into places of the tool.

    The surface is that of the start, so a tool that stays in place does not dig itself in. Where
    the cursor leaves the clay, the path continues in the plane of the view through the last place.
    Where the cursor crosses an edge to something far behind or in front, the path jumps.

    Args:
        surface: The clay when the stroke begins.
        radius: Of the brush [m].
        level: Follow the surface low-passed.
        flat: Follow the plane of the view through the first place, and no surface.
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
        """Where the stroke begins; None if there is no clay in front of the viewer.

        Args:
            view: The view that the cursor is in.
            x: From the region's left edge [pixels].
            y: From its lower edge [pixels].
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
        """Begin at another place than `begin` found, with the cursor where it is."""
        self._last = waypoint

    def extend(self, view: View, x: float, y: float) -> list[Waypoint]:
        """The waypoints on the way to a new place of the cursor.

        Args:
            view: The view that the cursor is in.
            x: From the region's left edge [pixels].
            y: From its lower edge [pixels].
        """
        assert self._last is not None, "begin comes first"
        far = math.dist(self._pixel, (x, y))
        if far < 0.5:
            return []
        pixel = view.pixel(self._last.point)
        step = max(0.5 * self.radius / max(pixel, 1e-12), _MIN_PIXELS)
        pieces = min(max(math.ceil(far / step), 1), _MAX_RAYS)
        begin, way = self._pixel, []
        for piece in range(1, pieces + 1):
            part = piece / pieces
            place = (begin[0] + part * (x - begin[0]), begin[1] + part * (y - begin[1]))
            way.append(self._follow(view, *place, expected=far / pieces * pixel))
        self._pixel = (x, y)
        return way

    def _follow(self, view: View, x: float, y: float, expected: float) -> Waypoint:
        last = self._last
        assert last is not None
        ray = view.ray(x, y)
        found = None if self.flat else self._cast(ray)
        if found is None:
            point = ray.meet_plane(last.point, view.forward)
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
