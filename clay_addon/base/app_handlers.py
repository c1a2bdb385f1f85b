# SPDX-License-Identifier: GPL-3.0-or-later
"""Functions that Blender calls, each registered once, and having it draw its views anew."""

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
    """Have all 3D views, and the panels beside them, drawn anew."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()
