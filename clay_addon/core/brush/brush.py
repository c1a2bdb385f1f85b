# SPDX-License-Identifier: GPL-3.0-or-later
"""The brush: turns queued input into poses of its tool's meshes and into edits."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....solver.geometry.rotations import frame_of, tangent_of
from ..tools.edits import Edit
from ..tools.meshes import is_thin, sole_radius, tool_parts
from ..tools.settings import BrushSettings, ToolMesh
from .adjust import Adjustment
from .edit_stroke import EditStroke
from .input import BrushInput, Sample, Source
from .mirror import mirror_matrices
from .raycast import ParticleSurface
from .stroke import HOVER, Stroke
from .tool_poses import copy_poses, fence_pose, part_poses
from .view_region import Pointer


@dataclass(frozen=True)
class Cursor:
    """Where the brush is drawn on the clay."""

    point: NDArray[np.float64]
    """Point on the surface [m], shape [3]."""
    normal: NDArray[np.float64]
    """Unit normal of the surface, shape [3]."""
    on_clay: bool
    """Whether it is on the clay, not beside it."""


class Brush:
    """Applies a tool to the clay in a live session, controlled by mouse, pen and keys.

    `handle` queues events of Blender's window. Before each step of the solver, `poses` gets the
    clay and turns the queue into poses of the tool; `take_edits` returns what to add, remove and
    paint. Rays are cast in `poses` only, so a fast mouse costs no more than a slow one.

    Args:
        source: Provides and stores the settings.
    """

    def __init__(self, source: Source) -> None:
        self._source = source
        self._settings = source.read()
        self._input = BrushInput(source)
        self._made: tuple[Hashable, list[ToolMesh], float] | None = None
        self._stroke: Stroke | None = None
        self._edit_stroke: EditStroke | None = None
        self._edits: list[Edit] = []
        self._positions = np.zeros((0, 3), np.float32)
        self._blade_radius = 0.0
        self._poses: list[tuple[NDArray[np.float64], bool]] = []
        self.cursor: Cursor | None = None
        """Where the brush is on the clay; None if there is no clay under it."""

    # For the session ------------------------------------------------------------------------------

    @property
    def settings(self) -> BrushSettings:
        """The settings of the brush; during a stroke, those at its start."""
        return self._settings

    @property
    def mesh_key(self) -> Hashable:
        """A key that changes when `meshes` do, but never during a stroke.

        The radius affects only the poses, except for blades, whose thickness follows the spacing.
        """
        self._refresh()
        return self._key_of_meshes()

    def _key_of_meshes(self) -> Hashable:
        settings = self._settings
        if settings.tool.path == "edit":
            return ("edit",)
        stamp = settings.stamp_key if settings.tool.identifier == "STAMP" else ""
        key = (settings.tool.identifier, stamp, settings.mirror, settings.spacing)
        if not is_thin(settings.tool):
            return key
        # While the radius is being adjusted, a blade is only scaled.
        if self._input.adjustment is None or self._blade_radius == 0.0:
            self._blade_radius = settings.radius
        return (*key, self._blade_radius)

    @property
    def stroking(self) -> bool:
        """Whether a stroke is in progress; it may continue briefly after the button is up."""
        return self._input.stroking or self._stroke is not None

    @property
    def pointer(self) -> Pointer | None:
        """The mouse in a 3D view; None outside the 3D views."""
        return self._input.pointer

    @property
    def adjustment(self) -> Adjustment | None:
        """The ongoing adjustment of radius or strength, if any."""
        return self._input.adjustment

    def meshes(self) -> list[ToolMesh]:
        """The tool's meshes for each mirrored copy, in the order of `poses`."""
        self._refresh()
        parts, _ = self._parts()
        return parts * len(mirror_matrices(self._settings.mirror, self._settings.mirror_frame))

    def drawn(self) -> list[tuple[ToolMesh, NDArray[np.float64], bool]]:
        """Meshes to draw, their poses [m], and whether they act on the clay; empty off the clay."""
        if self.cursor is None:
            return []
        meshes = self.meshes()
        if len(meshes) != len(self._poses):
            return []
        shown = zip(meshes, self._poses, strict=True)
        drawn = [(mesh, pose, enabled) for mesh, (pose, enabled) in shown]
        # The plate that holds the clay for a blade is not drawn.
        return drawn[::2] if self._settings.tool.held else drawn

    def poses(
        self, duration: float, positions: NDArray[np.floating]
    ) -> list[tuple[NDArray[np.float64], bool]]:
        """Poses of the tool's meshes at the end of the next step, and whether they act on the clay.

        Args:
            duration: Simulated time of the step [s].
            positions: World positions of all particles as displayed [Blender units], shape [N, 3].

        Returns:
            For each of `meshes`, the matrix to the world [m], shape [4, 4], including scale and
            mirroring, and whether it acts on the clay.
        """
        self._positions = positions
        self._refresh()
        press = self._input.take_press()
        if press is not None:
            # A new stroke ends one that has not quite finished.
            self._stroke = self._edit_stroke = None
            self._begin(press)
        if self._stroke is not None:
            self._advance(duration)
        elif self._edit_stroke is not None:
            self._dab()
        else:
            self._hover()
        return list(self._poses)

    def take_edits(self) -> list[Edit]:
        """Edits since the last call, in order."""
        edits, self._edits = self._edits, []
        return edits

    def cancel(self) -> None:
        """Cancel everything: a stroke ends where it is, and an adjusted value is restored."""
        self._input.cancel()
        self._stroke = self._edit_stroke = None
        self._poses = [(pose, False) for pose, _ in self._poses]

    # Events ---------------------------------------------------------------------------------------

    def handle(self, context: Any, event: Any) -> bool:
        """Handle an event of Blender's window.

        Args:
            context: The context of the event's window.
            event: The event.

        Returns:
            Whether the brush has consumed the event.
        """
        if event.type.startswith("TIMER") or event.type == "NONE":
            return False
        if event.value == "PRESS":
            self._refresh()
        taken = self._input.handle(context, event, self._settings, self._world_point)
        if self._input.take_cancel():
            self.cancel()
        return taken

    def status_text(self) -> str:
        """What keys and buttons currently do, for the status bar."""
        return self._input.status_text(self._settings)

    # Strokes --------------------------------------------------------------------------------------

    def _refresh(self) -> None:
        """Read the settings again, unless a stroke is in progress."""
        if not self.stroking and self._edit_stroke is None:
            self._settings = self._source.read()

    def _surface(self, *, keep: bool = False) -> ParticleSurface:
        """The surface of the clay as displayed; with `keep`, a snapshot that does not change."""
        scale = np.float32(self._settings.scale)
        points = np.asarray(self._positions, np.float32)
        if scale != 1.0:
            points = points * scale
        elif keep:
            points = points.copy()
        return ParticleSurface(points, self._settings.spacing)

    def _begin(self, press: Sample) -> None:
        pointer = press.pointer
        if not len(self._positions):
            self._input.release()
            return
        surface = self._surface(keep=True)
        place = (self._settings, surface, pointer.view, pointer.x, pointer.y)
        try:
            if self._settings.tool.edit is not None:
                self._edit_stroke = EditStroke(*place, inverted=press.ctrl, pressure=press.pressure)
            else:
                parts, made_radius = self._parts()
                own = parts[:1] if self._settings.tool.held else parts
                sole = sole_radius(own, made_radius) * self._settings.radius / made_radius
                self._stroke = Stroke(*place, sole=sole, pressure=press.pressure)
        except LookupError:
            self._input.release()

    def _advance(self, duration: float) -> None:
        stroke = self._stroke
        assert stroke is not None
        for sample in self._input.take_samples():
            at = sample.pointer
            stroke.move(at.view, at.x, at.y, pressure=sample.pressure, pull=sample.shift)
        stroke.wheel(self._input.take_wheel())
        if not self._input.held:
            stroke.release()
        stroke.advance(duration)
        self.cursor = Cursor(stroke.base.point, stroke.base.normal, stroke.base.on_clay)
        self._pose(stroke.tip, stroke.rotation, stroke.enabled, stroke.gap, stroke.rolled)
        if stroke.finished:
            self._stroke = None

    def _dab(self) -> None:
        stroke = self._edit_stroke
        assert stroke is not None
        for sample in self._input.take_samples():
            at = sample.pointer
            stroke.move(at.view, at.x, at.y, pressure=sample.pressure)
        self._edits += stroke.take()
        self.cursor = Cursor(stroke.base.point, stroke.base.normal, stroke.base.on_clay)
        self._poses = []
        if not self._input.held:
            self._edit_stroke = None

    def _hover(self) -> None:
        """Without a stroke, place the tool above the clay under the cursor."""
        if self._input.adjustment is None:
            pointer, settings = self._input.pointer, self._settings
            self.cursor = None
            if pointer is not None and settings.tool.identifier != "NONE":
                ray = pointer.view.ray(pointer.x, pointer.y)
                hit = self._surface().hit(ray.origin, ray.direction, settings.radius)
                if hit is not None:
                    self.cursor = Cursor(hit.point, hit.normal, True)
        cursor, pointer = self.cursor, self._input.pointer
        if cursor is None or pointer is None:
            parts, _ = self._parts()
            copies = 2 ** sum(self._settings.mirror)
            if len(self._poses) != len(parts) * copies:
                self._poses = [(np.eye(4), False)] * (len(parts) * copies)
            self._poses = [(pose, False) for pose, _ in self._poses]
            return
        tangent = tangent_of(pointer.view.up, cursor.normal, pointer.view.right)
        rotation = frame_of(cursor.normal, tangent)
        tip = cursor.point + HOVER * self._settings.radius * cursor.normal
        self._pose(tip, rotation, False, None, 0.0)

    def _pose(
        self,
        tip: NDArray[np.float64],
        rotation: NDArray[np.float64],
        enabled: bool,
        gap: float | None,
        rolled: float,
    ) -> None:
        parts, made_radius = self._parts()
        extent = float(np.ptp(self._positions, axis=0).max()) * self._settings.scale
        count = len(parts) - self._settings.tool.held
        own = part_poses(self._settings, count, made_radius, gap, rolled, extent)
        self._poses = copy_poses(self._settings, tip, rotation, enabled, own)
        if self._settings.tool.held:
            self._add_fences(enabled)

    def _add_fences(self, enabled: bool) -> None:
        """Add a plate per copy to hold the clay while it is cut; only the first one is enabled."""
        direction = None if self._stroke is None else self._stroke.direction
        if self._stroke is None or direction is None:
            plate = np.eye(4)
        else:
            positions = self._stroke.surface.positions
            plate = fence_pose(self._settings, positions, direction, enabled)
        wires, self._poses = self._poses, []
        for number, wire in enumerate(wires):
            self._poses += [wire, (plate, enabled and direction is not None and number == 0)]

    def _world_point(self, pointer: Pointer) -> NDArray[np.float64]:
        """World position of the cursor [m], even beside the clay."""
        if self.cursor is not None:
            return self.cursor.point
        ray = pointer.view.ray(pointer.x, pointer.y)
        distance = self._surface().nearest_distance(ray.origin, ray.direction)
        return ray.at(1.0 if distance is None else distance)

    def _parts(self) -> tuple[list[ToolMesh], float]:
        """The tool's meshes without mirrored copies, and the radius they were made for [m]."""
        key = self._key_of_meshes()
        if self._made is None or self._made[0] != key:
            self._made = (key, tool_parts(self._settings), self._settings.radius)
        return self._made[1], self._made[2]
