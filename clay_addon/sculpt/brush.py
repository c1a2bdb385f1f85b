# SPDX-License-Identifier: GPL-3.0-or-later
"""The tool in the mouse: what it does with the cursor, the pen and the wheel."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .adjust import LEAST_RADIUS, Adjusted, Adjustment
from .edit_stroke import EditStroke
from .edits import Edit
from .mirror import mirror_matrices
from .raycast import ParticleSurface
from .rigid import frame_of, tangent_of
from .settings import BrushSettings, ToolMesh
from .stroke import HOVER, Stroke
from .tool_meshes import is_thin, sole_radius, tool_parts
from .tool_poses import board_pose, copy_poses, part_poses
from .view_region import Pointer, find_pointer, pointer_in

_MOVES = ("MOUSEMOVE", "INBETWEEN_MOUSEMOVE")
_LEAST_PRESSURE = 0.05
"""A pen reports nothing at first."""
_STEP = 1.1
"""A press of [ or ] changes the radius by this factor."""


class Source(Protocol):
    """Where a brush's settings are kept; see `properties.SceneSource`."""

    def read(self) -> BrushSettings:
        """What is set now."""

    def write(self, name: Adjusted, value: float) -> None:
        """Set the radius [m] or the strength."""


@dataclass(frozen=True)
class Cursor:
    """What is drawn of a brush on the clay."""

    point: NDArray[np.float64]
    """On the surface [m], shape [3]."""
    normal: NDArray[np.float64]
    """Unit normal of the surface, shape [3]."""
    on_clay: bool
    """Whether it is on the clay or beside it."""


class Brush:
    """What the mouse does to the clay in a live session.

    `handle` gets the events of Blender's window, `poses` is asked where the tool is before each
    step of the solver, and `take_edits` what to add, take away and paint. Rays are cast in
    `poses` alone, so that a fast mouse costs no more than a slow one.

    Args:
        source: Where the settings are.
    """

    def __init__(self, source: Source) -> None:
        self._source = source
        self._settings = source.read()
        self._made: tuple[Hashable, list[ToolMesh], float] | None = None
        self._stroke: Stroke | None = None
        self._edit_stroke: EditStroke | None = None
        self._edits: list[Edit] = []
        self._positions = np.zeros((0, 3), np.float32)
        self._pointer: Pointer | None = None
        self._samples: list[tuple[Pointer, float, bool]] = []
        self._pressed: tuple[Pointer, float, bool] | None = None
        self._held = False
        self._blade_radius = 0.0
        self._adjustment: Adjustment | None = None
        self._poses: list[tuple[NDArray[np.float64], bool]] = []
        self.cursor: Cursor | None = None
        """Where the brush is on the clay; None if it is nowhere near."""

    # What the session asks ------------------------------------------------------------------------

    @property
    def settings(self) -> BrushSettings:
        """What the brush is set to: during a stroke, what it was when that began."""
        return self._settings

    @property
    def mesh_key(self) -> Hashable:
        """Changes when `meshes` do, which never is in the middle of a stroke.

        A radius changes poses only, but for blades, which are as thick as the spacing asks for.
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
        # While a radius is being chosen, a blade is drawn scaled.
        if self._adjustment is None or self._blade_radius == 0.0:
            self._blade_radius = settings.radius
        return (*key, self._blade_radius)

    @property
    def stroking(self) -> bool:
        """Whether a stroke is under way, also after the button while the tool has not done."""
        return self._pressed is not None or self._stroke is not None or self._held

    @property
    def adjustment(self) -> Adjustment | None:
        """The radius or strength that is being chosen."""
        return self._adjustment

    def meshes(self) -> list[ToolMesh]:
        """What works the clay: the tool's parts for each mirrored copy, in the order of `poses`."""
        self._refresh()
        parts, _ = self._parts()
        return parts * len(mirror_matrices(self._settings.mirror, self._settings.mirror_frame))

    def drawn(self) -> list[tuple[ToolMesh, NDArray[np.float64], bool]]:
        """Meshes, their poses [m] and whether the clay feels them; none where there is no tool."""
        if self.cursor is None:
            return []
        meshes = self.meshes()
        if len(meshes) != len(self._poses):
            return []
        shown = zip(meshes, self._poses, strict=True)
        drawn = [(mesh, pose, felt) for mesh, (pose, felt) in shown]
        # Nobody needs to see the board that holds the clay for a wire.
        return drawn[::2] if self._settings.tool.path == "view" else drawn

    def poses(self, duration: float) -> list[tuple[NDArray[np.float64], bool]]:
        """Where the tool's meshes are after so many seconds, and whether the clay feels them.

        Args:
            duration: Of the coming step, simulated time [s].

        Returns:
            World from the mesh's coordinates [m], shape [4, 4], scaled and mirrored where needed,
            and whether it is felt; in the order of `meshes`.
        """
        self._refresh()
        if self._pressed is not None:
            self._begin()
        if self._stroke is not None:
            self._advance(duration)
        elif self._edit_stroke is not None:
            self._dab()
        else:
            self._hover()
        return list(self._poses)

    def take_edits(self) -> list[Edit]:
        """What to do to the clay since the last call, in order."""
        edits, self._edits = self._edits, []
        return edits

    def cancel(self) -> None:
        """Let go of everything: the stroke ends where it is, a value being chosen is taken back."""
        if self._adjustment is not None:
            self._source.write(self._adjustment.name, self._adjustment.start)
        self._adjustment = None
        self._stroke = self._edit_stroke = self._pressed = None
        self._held = False
        self._samples.clear()
        self._poses = [(pose, False) for pose, _ in self._poses]

    # Events ---------------------------------------------------------------------------------------

    def handle(self, context: Any, event: Any, positions: NDArray[np.floating]) -> bool:
        """Take an event of Blender's window.

        Args:
            context: With the window that the event is of.
            event: The event.
            positions: Where the particles are now, world [Blender units], shape [N, 3].

        Returns:
            Whether the event was the brush's, so that nobody else is to get it.
        """
        self._positions = positions
        if event.type.startswith("TIMER") or event.type == "NONE":
            return False
        if self._adjustment is not None:
            return self._adjust(context, event)
        if self._held:
            return self._steer(context, event)
        pointer = find_pointer(context, event.mouse_x, event.mouse_y)
        self._pointer = pointer
        if pointer is None or event.type in _MOVES or event.value != "PRESS":
            return False
        self._refresh()
        if event.type == "SPACE" and event.shift:
            open_tool_menu()
            return True
        if self._settings.tool.identifier == "NONE":
            return False
        if event.type == "LEFTMOUSE":
            return self._press(pointer, event)
        return self._key(context, event, pointer)

    def _press(self, pointer: Pointer, event: Any) -> bool:
        edits = self._settings.tool.edit in ("add", "remove")
        if event.alt or event.shift or event.oskey or (event.ctrl and not edits):
            return False
        if not len(self._positions):
            return False
        # A stroke that has not quite done makes way for the next one.
        self._stroke = self._edit_stroke = None
        self._pressed = (pointer, self._pressure(event), bool(event.ctrl))
        self._held = True
        self._samples.clear()
        return True

    def _steer(self, context: Any, event: Any) -> bool:
        """During a stroke all events are the brush's."""
        if event.type in _MOVES:
            assert self._pointer is not None
            area, region = self._pointer.area, self._pointer.region
            pointer = pointer_in(context, area, region, event.mouse_x, event.mouse_y)
            self._pointer = pointer
            self._samples.append((pointer, self._pressure(event), bool(event.shift)))
        elif event.type in ("LEFTMOUSE", "WINDOW_DEACTIVATE"):
            if event.value == "RELEASE" or event.type == "WINDOW_DEACTIVATE":
                self._held = False
        elif event.type in ("ESC", "RIGHTMOUSE") and event.value == "PRESS":
            self.cancel()
        elif event.type in ("WHEELUPMOUSE", "WHEELDOWNMOUSE") and self._stroke is not None:
            self._stroke.wheel(1.0 if event.type == "WHEELDOWNMOUSE" else -1.0)
        return True

    def _key(self, context: Any, event: Any, pointer: Pointer) -> bool:
        if event.ctrl or event.alt or event.oskey:
            return False
        if event.type == "F":
            name: Adjusted = "strength" if event.shift else "radius"
            place = self._place(pointer)
            start = getattr(self._settings, name)
            self._adjustment = Adjustment(name, start, pointer.view.pixel(place), event.mouse_x)
            self._tell(context)
            return True
        if event.type in ("LEFT_BRACKET", "RIGHT_BRACKET") and not event.shift:
            factor = _STEP if event.type == "RIGHT_BRACKET" else 1.0 / _STEP
            self._source.write("radius", max(self._settings.radius * factor, LEAST_RADIUS))
            return True
        return False

    def status_text(self) -> str:
        """What keys and buttons do at the moment, for the status bar."""
        if self._adjustment is not None:
            return "Left mouse: confirm   Right mouse: cancel   Shift: finely"
        tool = self._settings.tool
        if self._held and tool.path == "pinch":
            return "Wheel or Shift: pull away from the surface   Esc: let go"
        if self._held and tool.edit is None and tool.path != "view":
            return "Wheel: deeper or less deep   Esc: let go"
        parts = []
        if tool.identifier != "NONE":
            parts.append(f"Left mouse: {tool.label}")
            if tool.edit in ("add", "remove"):
                parts.append("Ctrl: " + ("take away" if tool.edit == "add" else "add"))
            parts.append("F, [ ]: radius")
            parts.append("Shift F: strength")
        return "   ".join((*parts, "Shift Space: tools", "Esc: finish"))

    def _adjust(self, context: Any, event: Any) -> bool:
        adjustment = self._adjustment
        assert adjustment is not None
        if event.type in _MOVES:
            value = adjustment.move(event.mouse_x, precise=bool(event.shift))
            self._source.write(adjustment.name, value)
        elif event.value == "PRESS" and event.type in ("LEFTMOUSE", "RET", "NUMPAD_ENTER", "SPACE"):
            self._adjustment = None
        elif event.value == "PRESS" and event.type in ("RIGHTMOUSE", "ESC"):
            self.cancel()
        self._refresh()
        self._tell(context)
        return True

    def _tell(self, context: Any) -> None:
        """Show the value that is being chosen in the view's header."""
        pointer, adjustment = self._pointer, self._adjustment
        if pointer is None:
            return
        text = None
        if adjustment is not None and adjustment.name == "radius":
            text = f"Radius: {adjustment.value * 1e3:.3g} mm"
        elif adjustment is not None:
            text = f"Strength: {adjustment.value:.3f}"
        pointer.area.header_text_set(text)
        pointer.area.tag_redraw()

    def _pressure(self, event: Any) -> float:
        if not (self._settings.use_pressure and event.is_tablet):
            return 1.0
        return float(min(max(event.pressure, _LEAST_PRESSURE), 1.0))

    # Strokes --------------------------------------------------------------------------------------

    def _refresh(self) -> None:
        """Take up what is set now, but not in the middle of a stroke."""
        if not self.stroking and self._edit_stroke is None:
            self._settings = self._source.read()

    def _surface(self, *, keep: bool = False) -> ParticleSurface:
        """The clay as it is now; a copy where it is to stay so."""
        scale = np.float32(self._settings.scale)
        points = np.asarray(self._positions, np.float32)
        if scale != 1.0:
            points = points * scale
        elif keep:
            points = points.copy()
        return ParticleSurface(points, self._settings.spacing)

    def _begin(self) -> None:
        assert self._pressed is not None
        (pointer, pressure, inverted), self._pressed = self._pressed, None
        surface = self._surface(keep=True)
        place = (self._settings, surface, pointer.view, pointer.x, pointer.y)
        try:
            if self._settings.tool.edit is not None:
                self._edit_stroke = EditStroke(*place, inverted=inverted, pressure=pressure)
            else:
                parts, made_radius = self._parts()
                sole = sole_radius(parts, made_radius) * self._settings.radius / made_radius
                self._stroke = Stroke(*place, sole=sole)
        except LookupError:
            self._held = False

    def _advance(self, duration: float) -> None:
        stroke = self._stroke
        assert stroke is not None
        for pointer, pressure, pull in _thinned(self._samples):
            stroke.move(pointer.view, pointer.x, pointer.y, pressure=pressure, pull=pull)
        self._samples.clear()
        if not self._held:
            stroke.release()
        stroke.advance(duration)
        self.cursor = Cursor(stroke.base.point, stroke.base.normal, stroke.base.on_clay)
        self._pose(stroke.tip, stroke.rotation, stroke.enabled, stroke.gap, stroke.rolled)
        if stroke.finished:
            self._stroke = None

    def _dab(self) -> None:
        stroke = self._edit_stroke
        assert stroke is not None
        for pointer, pressure, _ in _thinned(self._samples):
            stroke.move(pointer.view, pointer.x, pointer.y, pressure=pressure)
        self._samples.clear()
        self._edits += stroke.take()
        self.cursor = Cursor(stroke.base.point, stroke.base.normal, stroke.base.on_clay)
        self._poses = []
        if not self._held:
            self._edit_stroke = None

    def _hover(self) -> None:
        """Without a stroke the tool floats over the clay under the cursor."""
        if self._adjustment is None:
            pointer, settings = self._pointer, self._settings
            self.cursor = None
            if pointer is not None and settings.tool.identifier != "NONE":
                ray = pointer.view.ray(pointer.x, pointer.y)
                hit = self._surface().hit(ray.origin, ray.direction, settings.radius)
                if hit is not None:
                    self.cursor = Cursor(hit.point, hit.normal, True)
        cursor, pointer = self.cursor, self._pointer
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
        own = part_poses(self._settings, len(parts), made_radius, gap, rolled, extent)
        self._poses = copy_poses(self._settings, tip, rotation, enabled, own)
        if self._settings.tool.path == "view":
            self._add_boards(enabled)

    def _add_boards(self, enabled: bool) -> None:
        """Hold the clay while a wire cuts it; there is a board beside each copy, and one holds."""
        surface = self._stroke.surface if self._stroke is not None else self._surface()
        board = board_pose(self._settings, surface.positions, enabled)
        wires = self._poses
        self._poses = []
        for which, wire in enumerate(wires):
            self._poses += [wire, (board, enabled and which == 0)]

    def _place(self, pointer: Pointer) -> NDArray[np.float64]:
        """Where the cursor is in the world [m], also beside the clay."""
        if self.cursor is not None:
            return self.cursor.point
        ray = pointer.view.ray(pointer.x, pointer.y)
        distance = self._surface().nearest_distance(ray.origin, ray.direction)
        return ray.at(1.0 if distance is None else distance)

    def _parts(self) -> tuple[list[ToolMesh], float]:
        """The tool's meshes without copies, and the radius they were made for [m]."""
        key = self._key_of_meshes()
        if self._made is None or self._made[0] != key:
            self._made = (key, tool_parts(self._settings), self._settings.radius)
        return self._made[1], self._made[2]


def open_tool_menu() -> None:
    """Show all tools at the mouse, where Blender's toolbar pops up too."""
    import bpy

    bpy.ops.wm.call_menu(name="CLAY_MT_sculpt_tools")


def _thinned(
    samples: list[tuple[Pointer, float, bool]], most: int = 6
) -> list[tuple[Pointer, float, bool]]:
    """Some of many events evenly, the last always."""
    step = -(-len(samples) // most) if samples else 1
    return samples[::-1][::step][::-1]
