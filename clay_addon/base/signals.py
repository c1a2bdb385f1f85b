# SPDX-License-Identifier: GPL-3.0-or-later
"""Signals: a property that changes says so here, and whoever shows or uses it listens.

So the properties need not know the rooms above them. Nothing is kept between Blender's runs, and a
listener that is connected twice is called once.
"""

from __future__ import annotations

from collections.abc import Callable

import bpy


class SceneSignal:
    """Calls its listeners with the scene in which something has changed."""

    def __init__(self) -> None:
        self._listeners: list[Callable[[bpy.types.Scene], object]] = []

    def connect(self, listener: Callable[[bpy.types.Scene], object]) -> None:
        """Have a function called from now on."""
        if listener not in self._listeners:
            self._listeners.append(listener)

    def disconnect(self, listener: Callable[[bpy.types.Scene], object]) -> None:
        """Have it called no more; nothing where it never was."""
        if listener in self._listeners:
            self._listeners.remove(listener)

    def send(self, scene: bpy.types.Scene) -> None:
        """Call all listeners, in the order in which they were connected."""
        for listener in tuple(self._listeners):
            listener(scene)


held_frames_changed = SceneSignal()
"""For how many frames each simulated shape is held."""
wheels_changed = SceneSignal()
"""How fast a potter's wheel of the scene turns, or where it starts from."""
