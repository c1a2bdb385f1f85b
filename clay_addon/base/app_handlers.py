# SPDX-License-Identifier: GPL-3.0-or-later
"""Functions that Blender calls, each registered once however often it is asked for."""

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
