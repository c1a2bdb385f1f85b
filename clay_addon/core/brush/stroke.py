# SPDX-License-Identifier: GPL-3.0-or-later
"""One stroke of a tool that touches the clay: where it is, and no faster than a hand."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from ....solver.geometry.rotations import frame_of, tangent_of, turned_towards
from ..tools.meshes import is_aligned
from ..tools.settings import BrushSettings
from .raycast import ParticleSurface
from .surface_path import SurfacePath, Waypoint
from .view_ray import View

_EASE = 0.06
"""The depth follows what is asked for with this time constant [s]: a mouse knows no pressure."""
_TURN = 12.0
"""A tool turns no faster than this [rad/s]."""
_CLEAR = 0.8
"""A tool is set down so far above the clay [spacings]."""
_WHEEL = 0.15
"""One step of the wheel changes the depth by this [brush radii]."""
_PULL = 0.4
"""One step of the wheel pulls a pinch by this [brush radii]."""
_LINGER = 0.5
"""After the button is let go, a tool has this long to reach its depth [s]."""
HOVER = 0.25
"""A tool that waits floats so far above the clay [brush radii]."""
_DIRECTED = 0.3
"""So far the cursor goes before its direction is known [brush radii]."""
_WAIT = 0.4
"""A tool does not wait longer than this for its direction [s]."""
PINCH_OPEN = 1.6
"""Half the distance of the axes of two fingers before they close [brush radii]."""
PINCH_LEAN = np.radians(30.0)
"""Fingertips that pinch are nearer to each other than the fingers are, so that clay between them
comes along when they rise."""
_PINCH_SPEED = 0.12
"""How fast two fingers close [m/s]."""


class Stroke:
    """A tool on its way, from the press of the button until it has done.

    First the tool stands clear of the clay, which does not feel it yet. Then it goes down to its
    depth under the surface as that was at the beginning, and along with the cursor. Where the path
    jumps, it is lifted and set down anew.

    Args:
        settings: Of the brush, kept for the whole stroke.
        surface: The clay now.
        view: What the cursor is in.
        x: From the region's left edge [pixels].
        y: From its lower edge [pixels].
        sole: How far the tool reaches sideways [m]; the brush's radius where that is more.
        pressure: Of the pen, 0 to 1; 1 for a mouse.

    Raises:
        LookupError: There is no clay in front of the eye.
    """

    def __init__(
        self,
        settings: BrushSettings,
        surface: ParticleSurface,
        view: View,
        x: float,
        y: float,
        *,
        sole: float = 0.0,
        pressure: float = 1.0,
    ) -> None:
        self.settings = settings
        self.tool = settings.tool
        self.surface = surface
        self._sole = max(sole, settings.radius)
        self.path = SurfacePath(
            surface, settings.radius, level=self.tool.path == "level", flat=self.is_flat
        )
        first = self.path.begin(view, x, y)
        if first is None:
            raise LookupError("There is no clay in front of the eye.")
        if self.tool.path == "view":
            first = self._through_clay(view, x, y)
        self.base = first
        self.rotation = frame_of(first.normal, _first_tangent(view, first.normal, self.tool.path))
        self._tangent = self.rotation[:, 1]
        self.depth = -HOVER * settings.radius
        self.tip = first.point - self.depth * first.normal
        self.gap = PINCH_OPEN * settings.radius
        """Half the distance of two fingers' axes [m]."""
        self.direction: NDArray[np.float64] | None = None
        """Unit vector along which a tool that had to know it has set out, shape [3]."""
        self.rolled = 0.0
        """Angle that a tool that rolls has turned [rad]."""
        self.enabled = False
        """Whether the clay feels the tool."""
        self.released = False
        """Whether the button is up again."""
        self._queue: deque[Waypoint] = deque()
        self._pressure = pressure
        self._extra = 0.0
        self._lingered = 0.0
        self._standing = False
        self._waited = 0.0
        self._undirected = is_aligned(self.tool)
        self._shifted = (0.0, 0.0)
        self._cursor = (x, y)

    @property
    def is_flat(self) -> bool:
        """Whether it follows no surface."""
        return self.tool.path in ("view", "pinch")

    @property
    def wanted_depth(self) -> float:
        """How far under the surface the tool is to be [m]."""
        if self.tool.path == "view":
            return 0.0
        deep = self.tool.depth * self.settings.strength * self._pressure
        # Fingers close before they pull.
        return deep * self.settings.radius + (0.0 if self._closing else self._extra)

    @property
    def finished(self) -> bool:
        """Whether nothing is left to be done."""
        if not self.released or self._queue or not self._standing:
            return False
        reach = 0.05 * self.settings.radius
        target = self.base.point - self.wanted_depth * self.base.normal
        arrived = float(np.linalg.norm(self.tip - target)) < reach and not self._closing
        return arrived or self._lingered > _LINGER

    # What the user does ---------------------------------------------------------------------------

    def move(self, view: View, x: float, y: float, *, pressure: float, pull: bool) -> None:
        """The cursor has moved.

        Args:
            view: What it is in.
            x: From the region's left edge [pixels].
            y: From its lower edge [pixels].
            pressure: Of the pen, 0 to 1; 1 for a mouse.
            pull: Whether it moves a pinch along the surface's normal instead.
        """
        self._pressure = pressure
        if self.tool.path == "anchored":
            return
        before, self._cursor = self._cursor, (x, y)
        if pull and self.tool.path == "pinch":
            # What is pulled is not moved, now or when the key is let go.
            dx, dy = x - before[0], y - before[1]
            self._shifted = (self._shifted[0] + dx, self._shifted[1] + dy)
            self._extra -= dy * view.pixel(self.base.point)
            return
        x, y = x - self._shifted[0], y - self._shifted[1]
        for waypoint in self.path.extend(view, x, y):
            if self.tool.path == "view":
                ray = view.ray(x, y)
                waypoint = Waypoint(waypoint.point, -ray.direction, True)
            self._queue.append(waypoint)

    def wheel(self, steps: float) -> None:
        """Go deeper by steps of the wheel; less than 0 is less deep, and pulls a pinch out."""
        share = _PULL if self.tool.path == "pinch" else _WHEEL
        self._extra += steps * share * self.settings.radius

    def release(self) -> None:
        """The button is up."""
        self.released = True

    # What the tool does ---------------------------------------------------------------------------

    def advance(self, duration: float) -> None:
        """Go on for so many seconds of simulated time."""
        if not self._standing:
            if self._waits(duration):
                # Over the clay as before the stroke, for where it is going is not known yet.
                return
            self._set_down()
            return
        self.enabled = True
        if self.released:
            self._lingered += duration
        step = self.settings.speed * duration
        asked = self.wanted_depth - self.depth
        self.depth += float(np.clip(asked * min(1.0, duration / _EASE), -step, step))
        if self._closing:
            deep = self.wanted_depth - self.depth < 0.15 * self.settings.radius
            if deep:
                self.gap = max(self.gap - _PINCH_SPEED * duration, self.closed_gap)
        else:
            self._walk(step)
            if not self._standing:
                self._set_down()
                return
        target = self.base.point - self.depth * self.base.normal
        self.tip = self.tip + _shortened(target - self.tip, step)
        wanted = frame_of(self.base.normal, self._tangent)
        self.rotation = turned_towards(self.rotation, wanted, _TURN * duration)

    @property
    def closed_gap(self) -> float:
        """Half the distance of two fingers' axes when they hold clay [m]."""
        thin = max(0.5 * self.settings.spacing, 0.1 * self.settings.radius)
        # The fingertips are round, and lean, so they meet above the points that are posed.
        return self.tool.size * self.settings.radius * (1.0 - np.sin(PINCH_LEAN)) + thin

    @property
    def _closing(self) -> bool:
        return self.tool.path == "pinch" and self.gap > self.closed_gap

    def _waits(self, duration: float) -> bool:
        """Whether a tool that is to be turned along the stroke waits for its direction."""
        if not self._undirected:
            return False
        self._waited += duration
        way = (self._queue[-1] if self._queue else self.base).point - self.base.point
        if float(np.linalg.norm(way)) > _DIRECTED * self.settings.radius:
            self._tangent = tangent_of(way, self.base.normal, self._tangent)
            self.direction = way / float(np.linalg.norm(way))
        elif not self.released and (self._waited < _WAIT or self.tool.held):
            return True
        self._undirected = False
        return False

    def _set_down(self) -> None:
        """Stand clear of the clay, unfelt: the tool may have come from anywhere."""
        self._standing = True
        self.enabled = False
        if self.tool.path != "view":
            radius = self.settings.radius
            wide = self._sole + (PINCH_OPEN * radius if self.tool.path == "pinch" else 0.0)
            height = self.surface.height_above(
                self.base.point, self.base.normal, wide, 2.5 * radius
            )
            self.depth = -height - _CLEAR * self.settings.spacing
        self.tip = self.base.point - self.depth * self.base.normal
        self.rotation = frame_of(self.base.normal, self._tangent)

    def _walk(self, step: float) -> None:
        """Go along the path by a distance [m]."""
        radius = self.settings.radius
        while step > 0.0 and self._queue:
            waypoint = self._queue[0]
            if waypoint.jump:
                self.base = self._queue.popleft()
                self._standing = False
                return
            way = waypoint.point - self.base.point
            far = float(np.linalg.norm(way))
            if far <= step:
                self.base = self._queue.popleft()
            else:
                part = step / far
                normal = self.base.normal + part * (waypoint.normal - self.base.normal)
                normal /= max(float(np.linalg.norm(normal)), 1e-9)
                self.base = Waypoint(self.base.point + part * way, normal, waypoint.on_clay)
            walked = min(far, step)
            step -= walked
            if walked > 0.0:
                self._steer(way / far, walked, radius)

    def _steer(self, direction: NDArray[np.float64], walked: float, radius: float) -> None:
        """Turn the tool into the stroke's direction."""
        if self.tool.rolls:
            self.rolled -= float(direction @ self.rotation[:, 1]) * walked / radius
        if self.is_flat:
            return
        # There and back is one direction: no tool swings round where it turns back.
        if direction @ self._tangent < 0.0:
            direction = -direction
        blend = min(1.0, walked / (0.75 * radius))
        self._tangent = tangent_of(
            self._tangent + blend * (direction - self._tangent), self.base.normal, self._tangent
        )

    def _through_clay(self, view: View, x: float, y: float) -> Waypoint:
        """Where a wire begins: abreast of the clay's middle."""
        ray = view.ray(x, y)
        middle = self.surface.positions.mean(0, dtype=np.float64)
        depth = float((middle - ray.origin) @ view.forward) / float(ray.direction @ view.forward)
        start = Waypoint(ray.at(depth), -ray.direction, True)
        self.path.start_at(start)
        return start


def _shortened(vector: NDArray[np.float64], max_length: float) -> NDArray[np.float64]:
    """A vector cut to a length [m], shape [3]."""
    length = float(np.linalg.norm(vector))
    return vector if length <= max_length else vector * (max_length / length)


def _first_tangent(view: View, normal: NDArray[np.float64], path: str) -> NDArray[np.float64]:
    """Where +Y points before there is a direction: up on the screen, along the surface."""
    up = view.up - (view.up @ normal) * normal
    if path == "pinch":
        # Two fingers stand left and right of the cursor.
        right = tangent_of(view.right, normal, view.up)
        return np.cross(normal, right)
    if float(np.linalg.norm(up)) > 0.2:
        return tangent_of(up, normal, view.right)
    return tangent_of(view.forward, normal, view.right)
