# SPDX-License-Identifier: GPL-3.0-or-later
"""A block of clay, a camera that looks at it, and a mouse, without a Blender window."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from tactile_clay.clay_addon.core.brush.brush import Brush
from tactile_clay.clay_addon.core.tools.settings import BrushSettings
from tactile_clay.clay_addon.core.tools.tools import BY_IDENTIFIER

SPACING = 0.005
TICK = 1.0 / 60.0


def block(size: int = 20) -> Any:
    """A cube of lattice points around the origin; its faces are ``size / 2`` spacings away."""
    axis = (np.arange(size) - 0.5 * (size - 1)) * SPACING
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)


def look(
    eye: Any, *, up: Any = (0.0, 1.0, 0.0), width: int = 800, height: int = 600, persp: bool = True
) -> tuple[Any, Any]:
    """Perspective and view matrix of a camera at `eye` that looks at the origin."""
    eye = np.asarray(eye, float)
    back = eye / np.linalg.norm(eye)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    view = np.eye(4)
    view[:3, :3] = np.array((right, np.cross(back, right), back))
    view[:3, 3] = -view[:3, :3] @ eye
    near, far = 0.01, 100.0
    window = np.zeros((4, 4))
    if persp:
        window[0, 0], window[1, 1] = 2.0, 2.0 * width / height
        window[2, 2:] = (far + near) / (near - far), 2.0 * far * near / (near - far)
        window[3, 2] = -1.0
    else:
        window[0, 0], window[1, 1] = 8.0, 8.0 * width / height
        window[2, 2], window[3, 3] = -1.0 / far, 1.0
    return window @ view, view


@dataclass
class Event:
    """The fields of a Blender event that a brush reads."""

    type: str
    value: str = "PRESS"
    mouse_x: int = 0
    mouse_y: int = 0
    pressure: float = 1.0
    is_tablet: bool = False
    shift: bool = False
    ctrl: bool = False
    alt: bool = False
    oskey: bool = False


@dataclass
class Source:
    """Settings set by a test."""

    settings: BrushSettings = field(
        default_factory=lambda: BrushSettings(radius=0.012, spacing=SPACING)
    )

    def read(self) -> BrushSettings:
        """The current settings."""
        return self.settings

    def write(self, name: str, value: Any) -> None:
        """Set the radius or strength."""
        self.settings = replace(self.settings, **{name: value})

    def set(self, **values: Any) -> None:
        """Set any settings; the tool by its identifier."""
        if "tool" in values:
            values["tool"] = BY_IDENTIFIER[values["tool"]]
        self.settings = replace(self.settings, **values)


class Mouse:
    """A window with one 3D view of 800 by 600 pixels, its corner at (100, 50), seen from above."""

    def __init__(self) -> None:
        self.source = Source()
        self.clay = block().astype(np.float32)
        perspective, view = look((0.0, 0.0, 0.6))
        shown = SimpleNamespace(
            perspective_matrix=perspective, view_matrix=view, is_perspective=True
        )
        self.region = SimpleNamespace(
            type="WINDOW", x=100, y=50, width=800, height=600, data=shown, alignment="NONE"
        )
        self.panel = SimpleNamespace(
            type="UI", x=800, y=50, width=100, height=600, alignment="RIGHT"
        )
        self.header = ""
        self.area = SimpleNamespace(
            type="VIEW_3D", x=100, y=50, width=800, height=626,
            regions=[self.region, self.panel],
            spaces=SimpleNamespace(
                active=SimpleNamespace(show_gizmo=True, show_gizmo_navigate=True)
            ),
            header_text_set=self._set_header, tag_redraw=lambda: None,
        )  # fmt: skip
        self.context = SimpleNamespace(
            window=SimpleNamespace(screen=SimpleNamespace(areas=[self.area])),
            scene=SimpleNamespace(unit_settings=SimpleNamespace(scale_length=1.0)),
            preferences=SimpleNamespace(
                view=SimpleNamespace(mini_axis_type="GIZMO", gizmo_size_navigate_v3d=80),
                system=SimpleNamespace(ui_scale=1.0),
            ),
        )
        self.brush = Brush(self.source)
        self.place = (0.0, 0.0)

    def _set_header(self, text: str | None) -> None:
        self.header = text or ""

    def pixel(self, x: float, y: float, z: float = 0.05) -> tuple[int, int]:
        """The pixel of the window that shows a point [m]."""
        from tactile_clay.clay_addon.core.brush.view_region import pointer_in

        view = pointer_in(self.context, self.area, self.region, 0, 0).view
        seen = view.project((x, y, z))
        assert seen is not None
        return round(seen[0]) + 100, round(seen[1]) + 50

    def send(self, kind: str, value: str = "PRESS", **more: Any) -> bool:
        """Send an event at the last position of the mouse."""
        event = Event(kind, value, *self.at, **more)
        return self.brush.handle(self.context, event)

    at: tuple[int, int] = (0, 0)

    def move(self, x: float, y: float, **more: Any) -> bool:
        """Move the mouse to a point on the block's top [m]."""
        self.at = self.pixel(x, y)
        return self.send("MOUSEMOVE", "NOTHING", **more)

    def press(self, x: float = 0.0, y: float = 0.0, **more: Any) -> bool:
        """Press the left button at a point on the block's top [m]."""
        self.move(x, y)
        return self.send("LEFTMOUSE", **more)

    def ticks(self, count: int) -> list[Any]:
        """The poses at each of some ticks."""
        return [self.brush.poses(TICK, self.clay) for _ in range(count)]
