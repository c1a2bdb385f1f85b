# SPDX-License-Identifier: GPL-3.0-or-later
"""The Blender side: operators, panels, properties, bake, playback and the command line.

Importing and registering this package does not import Warp, which loads with the first clay.
"""

from __future__ import annotations

import importlib

_MODULES = (
    "base.preferences",
    "base.log",
    "base.activity",
    "base.later",
    "model.properties",
    "clay.make_clay",
    "sculpt.live.surface",
    "clay.material_operators",
    "model.collider",
    "scenes.operators",
    "hands.operators",
    "bake.operators",
    "wheel.wheel",
    "playback.playback",
    "take.operators",
    "deliver.export_operators",
    "playback.pack",
    "playback.pose_operators",
    "touch.foci_empties",
    "deliver.operators",
    "touch.properties",
    "touch.array",
    "touch.connection",
    "touch.operators",
    "touch.sensitivity",
    "touch.record",
    "touch.overlay",
    "sculpt.properties",
    "command.line",
    "panel",
    "touch.panel",
    "deliver.panel",
    "tracking.properties",
    "tracking.live",
    "tracking.operators",
    "tracking.panel",
    "sculpt.live.autosave",
    "sculpt.operators",
    "sculpt.overlay",
    "sculpt.header",
    "sculpt.panel",
    "sculpt.keymaps",
)
"""Submodules that have `register` and `unregister`, in registration order."""

_registered: list[str] = []

__all__ = ["register", "unregister"]


def register() -> None:
    """Register every part with Blender; a second call does nothing.

    If one part fails, the parts registered before it are unregistered again.
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
    """Undo everything `register` did; a second call does nothing."""
    while _registered:
        importlib.import_module(f".{_registered.pop()}", __package__).unregister()
