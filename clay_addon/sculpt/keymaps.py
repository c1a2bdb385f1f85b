# SPDX-License-Identifier: GPL-3.0-or-later
"""Alt C in Object Mode begins sculpting; Blender itself has nothing on that key."""

from __future__ import annotations

from typing import Any

import bpy

_entries: list[tuple[Any, Any]] = []


def register() -> None:
    """Add the key to the extensions' own keymap, where people can change it."""
    keyconfig = bpy.context.window_manager.keyconfigs.addon
    # In the background there is none.
    if keyconfig is None or _entries:
        return
    keymap = keyconfig.keymaps.new(name="Object Mode", space_type="EMPTY")
    _entries.append((keymap, keymap.keymap_items.new("clay.sculpt", "C", "PRESS", alt=True)))


def unregister() -> None:
    """Take the key away."""
    while _entries:
        keymap, entry = _entries.pop()
        keymap.keymap_items.remove(entry)
