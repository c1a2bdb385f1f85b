# SPDX-License-Identifier: GPL-3.0-or-later
"""The clay displayed by a live session: its points, and the surface shown in their place."""

from __future__ import annotations

import time
from collections.abc import Iterator

import bpy
import numpy as np
from numpy.typing import NDArray

from ...base.mesh_geometry import local_from_world, transform
from ...core.session.frame_budget import FrameBudget
from ...model.clay_points import keep_sculpted, write_points
from ...model.clay_scene import clay_colors
from ...simulate.simulation import Simulation
from .surface import LiveSurface

_MOVED = 0.02
"""Clay that moved less than this counts as unchanged [spacings]."""
_MOVED_FAR = 0.5
"""Clay that was not touched gets an undo step only if it moved farther than this [spacings], as it
springs back a little after each stroke."""


class LiveClay:
    """Writes positions to the point clouds of a scene, and makes them the starting shape.

    Args:
        budget: Records the time that this takes.
    """

    def __init__(self, budget: FrameBudget) -> None:
        self.positions = np.zeros((0, 3), np.float32)
        """World positions of all particles as displayed [Blender units], shape [N, 3]."""
        self.changed = False
        """Whether the clay has changed since the last undo step."""
        self.surface: LiveSurface | None = None
        """The surface shown in place of the clay; None until the first `show_surface`."""
        self._kept = self.positions
        self._budget = budget
        self._simulation: Simulation | None = None

    def switch_to(self, scene: bpy.types.Scene, simulation: Simulation) -> None:
        """Switch to the clay of a new simulation, as it is in Blender."""
        before, self._simulation = self._simulation, simulation
        self.positions = self._kept = np.concatenate(simulation.rest)
        if before is None or before.parts != simulation.parts:
            self.close_surface()
        else:
            self.offer_surface(scene)

    def show(self, scene: bpy.types.Scene, positions: NDArray[np.float32]) -> None:
        """Write new positions to the point clouds.

        Args:
            scene: The session's scene.
            positions: World positions of all particles [m], shape [N, 3].
        """
        simulation = self._simulation
        assert simulation is not None
        with self._budget.measured("write"):
            world = positions / np.float32(simulation.scale)
            # Sleeping clay does not move at all, so Blender need not redraw it.
            if np.array_equal(self.positions, world):
                return
            self.positions = world
            if not self.changed:
                self.changed = self._moved() > _MOVED * simulation.spacing
            for item, rows in self.by_object(scene, world):
                write_points(item, transform(local_from_world(item), rows))
        self.offer_surface(scene)

    def by_object(
        self, scene: bpy.types.Scene, values: NDArray[np.float32]
    ) -> Iterator[tuple[bpy.types.Object, NDArray[np.float32]]]:
        """Each clay object with its rows of an array that has one row per particle."""
        first = 0
        for part in self._simulation.parts if self._simulation else ():
            yield scene.objects[part.name], values[first : first + part.count]
            first += part.count

    def has_moved_far(self) -> bool:
        """Whether the clay has moved far enough since the last undo step to need another."""
        assert self._simulation is not None
        return self._moved() > _MOVED_FAR * self._simulation.spacing

    # Keeping ------------------------------------------------------------------------------------

    def store(self, scene: bpy.types.Scene) -> None:
        """Make the displayed clay the starting shape of a bake; deleted objects are skipped."""
        for part in self._simulation.parts if self._simulation else ():
            item = scene.objects.get(part.name)
            if item is not None:
                keep_sculpted(item)

    def mark_kept(self) -> None:
        """Record that the clay as displayed gets an undo step."""
        self._kept = self.positions
        self.changed = False

    # The surface --------------------------------------------------------------------------------

    def show_surface(self, context: bpy.types.Context) -> bool:
        """Show the latest surface, if there is a new one; returns whether the display changed."""
        if self.surface is None:
            clay = [item for item, _ in self.by_object(context.scene, self.positions)]
            self.surface = LiveSurface(context, clay)
            self.offer_surface(context.scene)
            return False
        began = time.perf_counter()
        shown = self.surface.show()
        if shown:
            self._budget.took("surface", time.perf_counter() - began)
        return shown

    def offer_surface(self, scene: bpy.types.Scene) -> None:
        """Request a surface of the clay as displayed."""
        if self.surface is not None:
            parts = self.by_object(scene, self.positions)
            self.surface.offer([(points, clay_colors(item)) for item, points in parts])

    def close_surface(self) -> None:
        """Show the clay itself again; a second call does nothing."""
        surface, self.surface = self.surface, None
        if surface is not None:
            surface.close()

    def _moved(self) -> float:
        """Maximum change of any coordinate since the last undo step [Blender units]."""
        return float(np.abs(self.positions - self._kept).max(initial=0.0))
