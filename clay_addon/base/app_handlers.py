# SPDX-License-Identifier: GPL-3.0-or-later
"""Functions that Blender calls, each registered once, and redrawing its 3D views."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import bpy

Handlers = Sequence[tuple[str, Callable[..., Any]]]
"""Names of lists in ``bpy.app.handlers``, and what goes into them."""


def add_handlers(handlers: Handlers) -> None:
    """Let Blender call functions; one that is there already stays as it is."""
    for name, handler in handlers:
        known = getattr(bpy.app.handlers, name)
        if handler not in known:
            known.append(handler)


def remove_handlers(handlers: Handlers) -> None:
    """Let Blender call them no more."""
    for name, handler in handlers:
        known = getattr(bpy.app.handlers, name)
        if handler in known:
            known.remove(handler)


def redraw_views() -> None:
    """Redraw all 3D views and the panels beside them."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


class ViewDrawing:
    """Draws over every 3D view, in world coordinates, between `start` and `stop`.

    Args:
        draw: Called by Blender whenever a 3D view is drawn.
    """

    def __init__(self, draw: Callable[[], None]) -> None:
        self._draw = draw
        self._handle: Any = None

    @property
    def active(self) -> bool:
        """Whether it draws."""
        return self._handle is not None

    def start(self) -> None:
        """Begin; a second call does nothing, and so does one in the background."""
        if not self.active and not bpy.app.background:
            self._handle = bpy.types.SpaceView3D.draw_handler_add(
                self._draw, (), "WINDOW", "POST_VIEW"
            )

    def stop(self) -> None:
        """End; a second call does nothing."""
        if self.active:
            bpy.types.SpaceView3D.draw_handler_remove(self._handle, "WINDOW")
            self._handle = None
