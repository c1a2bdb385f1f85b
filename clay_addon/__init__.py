# SPDX-License-Identifier: GPL-3.0-or-later
"""All that is Blender: operators, panel, properties, bake, playback and the command line.

Importing and registering this package imports no Warp: that is loaded with the first clay.
"""

from __future__ import annotations

import importlib

_MODULES = (
    "preferences",
    "properties",
    "make_clay",
    "live_surface",
    "material_operators",
    "collider",
    "scene_operators",
    "hand_operators",
    "bake_operators",
    "wheel",
    "playback",
    "sculpt.take_operators",
    "export_operators",
    "pack",
    "pose_operators",
    "foci_empties",
    "delivery_operators",
    "touch_properties",
    "touch_array",
    "touch",
    "touch_operators",
    "touch_sensitivity",
    "touch_record",
    "touch_overlay",
    "sculpt.properties",
    "command_line",
    "panel",
    "touch_panel",
    "delivery_panel",
    "tracking.properties",
    "tracking.live",
    "tracking.operators",
    "tracking.panel",
    "sculpt.autosave",
    "sculpt.operators",
    "sculpt.overlay",
    "sculpt.header",
    "sculpt.panel",
    "sculpt.keymaps",
)
"""Submodules with a `register` and an `unregister`, in the order of registering."""

_registered: list[str] = []

__all__ = ["register", "unregister"]


def register() -> None:
    """Register every part with Blender; a second call does nothing.

    If a part fails, those before it are taken back, so that nothing half-registered stays.
    """
    if _registered:
        return
    try:
        for name in _MODULES:
            importlib.import_module(f".{name}", __package__).register()
            _registered.append(name)
    except BaseException:
        unregister()
        raise


def unregister() -> None:
    """Take back all that `register` did; a second call does nothing."""
    while _registered:
        importlib.import_module(f".{_registered.pop()}", __package__).unregister()
