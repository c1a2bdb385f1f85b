# SPDX-License-Identifier: GPL-3.0-or-later
"""One stroke that adds, removes or paints clay: dabs along the cursor's path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..tools.edits import Edit, EditKind
from ..tools.settings import BrushSettings
from .mirror import mirror_matrices
from .raycast import ParticleSurface
from .surface_path import SurfacePath, Waypoint
from .view_ray import View

_DAB_DISTANCE = 0.4
"""Distance between dabs [brush radii]."""
_OPPOSITE: dict[EditKind, EditKind] = {"add": "remove", "remove": "add", "paint": "paint"}


class EditStroke:
    """Dabs on the surface as it was at the start, so that clay does not grow indefinitely.

    A dab that adds clay is a sphere that protrudes from the surface by strength times radius; one
    that removes clay reaches that deep into it.

    Args:
        settings: Settings of the brush for the whole stroke.
        surface: The clay's current surface.
        view: The view that the cursor is in.
        x: Cursor's distance from the region's left edge [pixels].
        y: Cursor's distance from the region's lower edge [pixels].
        inverted: Whether to remove instead of add, and vice versa.
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
        inverted: bool = False,
        pressure: float = 1.0,
    ) -> None:
        assert settings.tool.edit is not None
        self.settings = settings
        self.kind = _OPPOSITE[settings.tool.edit] if inverted else settings.tool.edit
        self.path = SurfacePath(surface, settings.radius)
        first = self.path.begin(view, x, y)
        if first is None:
            raise LookupError("There is no clay in front of the viewer.")
        self.base = first
        self.released = False
        self.strength = settings.strength * pressure
        self._edits: list[Edit] = []
        self._since = 0.0
        self._dab(first)

    def move(self, view: View, x: float, y: float, *, pressure: float) -> None:
        """Follow the cursor.

        Args:
            view: The view that the cursor is in.
            x: Cursor's distance from the region's left edge [pixels].
            y: Cursor's distance from the region's lower edge [pixels].
            pressure: Pen pressure, 0 to 1; 1 for a mouse.
        """
        self.strength = self.settings.strength * pressure
        interval = _DAB_DISTANCE * self.settings.radius
        for waypoint in self.path.extend(view, x, y):
            offset = waypoint.point - self.base.point
            length = float(np.linalg.norm(offset))
            if waypoint.jump or not waypoint.on_clay or length < 1e-12:
                self._since = interval
            else:
                along = interval - self._since
                while along <= length:
                    part = along / length
                    normal = self.base.normal + part * (waypoint.normal - self.base.normal)
                    normal /= max(float(np.linalg.norm(normal)), 1e-9)
                    self._dab(Waypoint(self.base.point + part * offset, normal, self.base.on_clay))
                    along += interval
                self._since = length - (along - interval)
            self.base = waypoint

    def release(self) -> None:
        """Record that the button is up."""
        self.released = True

    def take(self) -> list[Edit]:
        """The dabs since the last call."""
        edits, self._edits = self._edits, []
        return edits

    def _dab(self, place: Waypoint) -> None:
        if not place.on_clay or self.strength <= 0.0:
            return
        radius = self.settings.radius
        raised = {"add": self.strength - 1.0, "remove": 1.0 - self.strength, "paint": 0.0}
        center = place.point + raised[self.kind] * radius * place.normal
        edit = Edit(
            self.kind,
            _triple(center),
            radius,
            strength=self.strength if self.kind == "paint" else 1.0,
            color=self.settings.color,
        )
        frame = self.settings.mirror_frame
        for matrix in mirror_matrices(self.settings.mirror, frame):
            mirrored = matrix[:3, :3] @ center + matrix[:3, 3]
            self._edits.append(replace(edit, center=_triple(mirrored)))


def _triple(point: NDArray[np.float64]) -> tuple[float, float, float]:
    return (float(point[0]), float(point[1]), float(point[2]))
