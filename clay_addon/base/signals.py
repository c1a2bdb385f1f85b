# SPDX-License-Identifier: GPL-3.0-or-later
"""Signals: notify listeners when a property changes.

They keep `model.properties` independent of the packages that listen. Connections do not outlive
the Blender process, and a listener that is connected twice is called once.
"""

from __future__ import annotations

from collections.abc import Callable

import bpy


class SceneSignal:
    """Calls its listeners with the scene in which something changed."""

    def __init__(self) -> None:
        self._listeners: list[Callable[[bpy.types.Scene], object]] = []

    def connect(self, listener: Callable[[bpy.types.Scene], object]) -> None:
        """Call a function at every `send` from now on."""
        if listener not in self._listeners:
            self._listeners.append(listener)

    def disconnect(self, listener: Callable[[bpy.types.Scene], object]) -> None:
        """Stop calling a function; does nothing if it is not connected."""
        if listener in self._listeners:
            self._listeners.remove(listener)

    def send(self, scene: bpy.types.Scene) -> None:
        """Call all listeners, in the order they were connected."""
        for listener in tuple(self._listeners):
            listener(scene)


held_frames_changed = SceneSignal()
"""The number of frames for which each simulated shape is held has changed."""
wheels_changed = SceneSignal()
"""The speed or phase of a potter's wheel in the scene has changed."""
