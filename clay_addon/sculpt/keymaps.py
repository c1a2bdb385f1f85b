# SPDX-License-Identifier: GPL-3.0-or-later
"""Keymap: Alt C in Object Mode, which Blender itself does not use, starts sculpting."""

from __future__ import annotations

from typing import Any

import bpy

_entries: list[tuple[Any, Any]] = []


def register() -> None:
    """Add the key to the add-on keymap, where users can change it."""
    keyconfig = bpy.context.window_manager.keyconfigs.addon
    # It is None in the background.
    if keyconfig is None or _entries:
        return
    keymap = keyconfig.keymaps.new(name="Object Mode", space_type="EMPTY")
    _entries.append((keymap, keymap.keymap_items.new("clay.sculpt", "C", "PRESS", alt=True)))


def unregister() -> None:
    """Remove the key."""
    while _entries:
        keymap, entry = _entries.pop()
        keymap.keymap_items.remove(entry)
