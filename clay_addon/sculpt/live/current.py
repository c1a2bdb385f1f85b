# SPDX-License-Identifier: GPL-3.0-or-later
"""The running live session, if any, and the clay as it was before the last one."""

from __future__ import annotations

import bpy
from numpy.typing import NDArray

from ...core.tools.interface import Tools
from ...model.clay_scene import clay_colors, clay_objects, read_points
from .checks import SculptError
from .session import SculptSession


class CurrentSession:
    """Starts and ends sessions; there is never more than one."""

    def __init__(self) -> None:
        self.session: SculptSession | None = None
        """The running session, if any."""
        self.clay_before: dict[str, tuple[NDArray, NDArray]] = {}
        """Local positions and colors of each clay object, by name, before the last session."""

    def start(self, context: bpy.types.Context, tools: Tools | None = None) -> SculptSession:
        """Start sculpting a scene.

        Args:
            context: Context with the scene to sculpt.
            tools: The mouse's tools.

        Raises:
            SculptError: A session is already running, or the scene cannot be sculpted.
        """
        if self.session is not None:
            raise SculptError("Sculpt is already running. Press Esc or Finish to end it.")
        self.session = SculptSession(context, tools=tools)
        self.clay_before = clay_state(context.scene)
        return self.session

    def stop(self, context: bpy.types.Context | None) -> None:
        """End the session if one is running, and keep the clay as displayed.

        Args:
            context: None if Blender's data no longer belongs to the session.
        """
        ended, self.session = self.session, None
        if ended is not None:
            ended.finish(context)


current = CurrentSession()


def clay_state(scene: bpy.types.Scene) -> dict[str, tuple[NDArray, NDArray]]:
    """Local positions and colors of each clay object, by name."""
    state = {}
    for item in clay_objects(scene):
        local = read_points(item, "position")
        if local is not None:
            state[item.name] = (local, clay_colors(item))
    return state
