# SPDX-License-Identifier: GPL-3.0-or-later
"""Registering application handlers, redrawing the 3D views and drawing over them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import bpy

Handlers = Sequence[tuple[str, Callable[..., Any]]]
"""Names of lists in ``bpy.app.handlers``, each with a function to add to it."""


def add_handlers(handlers: Handlers) -> None:
    """Register functions with Blender; those already registered are not added again."""
    for name, handler in handlers:
        known = getattr(bpy.app.handlers, name)
        if handler not in known:
            known.append(handler)


def remove_handlers(handlers: Handlers) -> None:
    """Unregister functions; those not registered are ignored."""
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
        """Whether it is drawing."""
        return self._handle is not None

    def start(self) -> None:
        """Start drawing; does nothing if it is active, or if Blender runs in the background."""
        if not self.active and not bpy.app.background:
            self._handle = bpy.types.SpaceView3D.draw_handler_add(
                self._draw, (), "WINDOW", "POST_VIEW"
            )

    def stop(self) -> None:
        """Stop drawing; a second call does nothing."""
        if self.active:
            bpy.types.SpaceView3D.draw_handler_remove(self._handle, "WINDOW")
            self._handle = None
