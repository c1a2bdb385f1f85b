# SPDX-License-Identifier: GPL-3.0-or-later
"""One stroke of a tool that touches the clay, at the speed of a hand at most."""

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

_EASE_TIME = 0.06
"""Time constant with which the depth approaches its target [s], as a mouse has no pressure."""
_MAX_TURN_RATE = 12.0
"""Maximum angular velocity of a tool [rad/s]."""
_CLEARANCE = 0.8
"""Height above the clay at which a stroke starts [spacings]."""
_WHEEL_STEP = 0.15
"""Change of depth per step of the wheel [brush radii]."""
_PULL_STEP = 0.4
"""Pull of a pinch per step of the wheel [brush radii]."""
_MAX_LINGER = 0.5
"""Time that a tool has to reach its depth after the button is released [s]."""
HOVER = 0.25
"""Height of an idle tool above the clay [brush radii]."""
_MIN_TRAVEL = 0.3
"""Cursor travel after which the direction of a stroke is known [brush radii]."""
_MAX_WAIT = 0.4
"""Maximum time that a tool waits for its direction [s]."""
PINCH_OPEN = 1.6
"""Half the distance between the axes of two open fingers [brush radii]."""
PINCH_LEAN = np.radians(30.0)
"""Tilt of pinching fingers [rad]: their tips are closest together, so that they pull clay up."""
_PINCH_SPEED = 0.12
"""Closing speed of two fingers [m/s]."""


class Stroke:
    """A moving tool, from the press of the button until it has finished.

    The tool starts disabled and clear of the clay. Then it moves to its depth below the surface as
    it was at the start, and follows the cursor. At jumps of the path, the tool is lifted and set
    down again.

    Args:
        settings: Settings of the brush for the whole stroke.
        surface: The clay's current surface.
        view: The view that the cursor is in.
        x: Cursor's distance from the region's left edge [pixels].
        y: Cursor's distance from the region's lower edge [pixels].
        sole: Lateral extent of the tool [m]; the brush's radius is used if that is larger.
        pressure: Pen pressure, 0 to 1; 1 for a mouse.

    Raises:
        LookupError: There is no clay in front of the viewer.
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
            raise LookupError("There is no clay in front of the viewer.")
        if self.tool.path == "view":
            first = self._through_clay(view, x, y)
        self.base = first
        self.rotation = frame_of(first.normal, _first_tangent(view, first.normal, self.tool.path))
        self._tangent = self.rotation[:, 1]
        self.depth = -HOVER * settings.radius
        self.tip = first.point - self.depth * first.normal
        self.gap = PINCH_OPEN * settings.radius
        """Half the distance between the axes of two fingers [m]."""
        self.direction: NDArray[np.float64] | None = None
        """Initial direction of an aligned tool, shape [3]; None until it is known."""
        self.rolled = 0.0
        """Angle by which a rolling tool has turned [rad]."""
        self.enabled = False
        """Whether the tool acts on the clay."""
        self.released = False
        """Whether the button has been released."""
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
        """Whether the tool follows the plane of the view instead of the surface."""
        return self.tool.path in ("view", "pinch")

    @property
    def target_depth(self) -> float:
        """Target depth of the tool below the surface [m]."""
        if self.tool.path == "view":
            return 0.0
        deep = self.tool.depth * self.settings.strength * self._pressure
        # Fingers close before they pull.
        return deep * self.settings.radius + (0.0 if self._closing else self._extra)

    @property
    def finished(self) -> bool:
        """Whether the tool has nothing left to do."""
        if not self.released or self._queue or not self._standing:
            return False
        reach = 0.05 * self.settings.radius
        target = self.base.point - self.target_depth * self.base.normal
        arrived = float(np.linalg.norm(self.tip - target)) < reach and not self._closing
        return arrived or self._lingered > _MAX_LINGER

    # Input ----------------------------------------------------------------------------------------

    def move(self, view: View, x: float, y: float, *, pressure: float, pull: bool) -> None:
        """Follow the cursor.

        Args:
            view: The view that the cursor is in.
            x: Cursor's distance from the region's left edge [pixels].
            y: Cursor's distance from the region's lower edge [pixels].
            pressure: Pen pressure, 0 to 1; 1 for a mouse.
            pull: Whether the cursor moves a pinch along the surface normal instead.
        """
        self._pressure = pressure
        if self.tool.path == "anchored":
            return
        before, self._cursor = self._cursor, (x, y)
        if pull and self.tool.path == "pinch":
            # This travel must not move the pinch sideways, now or after Shift is released.
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
        """Go deeper by some steps of the wheel; negative steps go up, and pull with a pinch."""
        share = _PULL_STEP if self.tool.path == "pinch" else _WHEEL_STEP
        self._extra += steps * share * self.settings.radius

    def release(self) -> None:
        """Record that the button is up."""
        self.released = True

    # Motion ---------------------------------------------------------------------------------------

    def advance(self, duration: float) -> None:
        """Move for some simulated time [s]."""
        if not self._standing:
            if self._is_waiting(duration):
                # Stay above the clay until the direction is known.
                return
            self._set_down()
            return
        self.enabled = True
        if self.released:
            self._lingered += duration
        step = self.settings.speed * duration
        change = self.target_depth - self.depth
        self.depth += float(np.clip(change * min(1.0, duration / _EASE_TIME), -step, step))
        if self._closing:
            deep = self.target_depth - self.depth < 0.15 * self.settings.radius
            if deep:
                self.gap = max(self.gap - _PINCH_SPEED * duration, self.closed_gap)
        else:
            self._follow_path(step)
            if not self._standing:
                self._set_down()
                return
        target = self.base.point - self.depth * self.base.normal
        self.tip = self.tip + _shortened(target - self.tip, step)
        wanted = frame_of(self.base.normal, self._tangent)
        self.rotation = turned_towards(self.rotation, wanted, _MAX_TURN_RATE * duration)

    @property
    def closed_gap(self) -> float:
        """Half the distance between the axes of two fingers that hold clay [m]."""
        thin = max(0.5 * self.settings.spacing, 0.1 * self.settings.radius)
        # The fingertips are round and tilted, so they touch above their tips' origins.
        return self.tool.size * self.settings.radius * (1.0 - np.sin(PINCH_LEAN)) + thin

    @property
    def _closing(self) -> bool:
        return self.tool.path == "pinch" and self.gap > self.closed_gap

    def _is_waiting(self, duration: float) -> bool:
        """Whether a tool that is aligned with the stroke is still waiting for its direction."""
        if not self._undirected:
            return False
        self._waited += duration
        way = (self._queue[-1] if self._queue else self.base).point - self.base.point
        if float(np.linalg.norm(way)) > _MIN_TRAVEL * self.settings.radius:
            self._tangent = tangent_of(way, self.base.normal, self._tangent)
            self.direction = way / float(np.linalg.norm(way))
        elif not self.released and (self._waited < _MAX_WAIT or self.tool.held):
            return True
        self._undirected = False
        return False

    def _set_down(self) -> None:
        """Place the tool disabled and clear of the clay, as it may have come from anywhere."""
        self._standing = True
        self.enabled = False
        if self.tool.path != "view":
            radius = self.settings.radius
            wide = self._sole + (PINCH_OPEN * radius if self.tool.path == "pinch" else 0.0)
            height = self.surface.height_above(
                self.base.point, self.base.normal, wide, 2.5 * radius
            )
            self.depth = -height - _CLEARANCE * self.settings.spacing
        self.tip = self.base.point - self.depth * self.base.normal
        self.rotation = frame_of(self.base.normal, self._tangent)

    def _follow_path(self, step: float) -> None:
        """Move along the path by a distance [m]."""
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
        """Turn the tool toward the stroke's direction."""
        if self.tool.rolls:
            self.rolled -= float(direction @ self.rotation[:, 1]) * walked / radius
        if self.is_flat:
            return
        # Opposite directions are equivalent, so a tool does not turn around when a stroke reverses.
        if direction @ self._tangent < 0.0:
            direction = -direction
        blend = min(1.0, walked / (0.75 * radius))
        self._tangent = tangent_of(
            self._tangent + blend * (direction - self._tangent), self.base.normal, self._tangent
        )

    def _through_clay(self, view: View, x: float, y: float) -> Waypoint:
        """Start of a wire, at the depth of the clay's center in the view."""
        ray = view.ray(x, y)
        middle = self.surface.positions.mean(0, dtype=np.float64)
        depth = float((middle - ray.origin) @ view.forward) / float(ray.direction @ view.forward)
        start = Waypoint(ray.at(depth), -ray.direction, True)
        self.path.start_at(start)
        return start


def _shortened(vector: NDArray[np.float64], max_length: float) -> NDArray[np.float64]:
    """A vector shortened to a maximum length [m], shape [3]."""
    length = float(np.linalg.norm(vector))
    return vector if length <= max_length else vector * (max_length / length)


def _first_tangent(view: View, normal: NDArray[np.float64], path: str) -> NDArray[np.float64]:
    """Initial direction of the tool's +Y: up on the screen, tangential to the surface."""
    up = view.up - (view.up @ normal) * normal
    if path == "pinch":
        # The two fingers are to the left and right of the cursor.
        right = tangent_of(view.right, normal, view.up)
        return np.cross(normal, right)
    if float(np.linalg.norm(up)) > 0.2:
        return tangent_of(up, normal, view.right)
    return tangent_of(view.forward, normal, view.right)
