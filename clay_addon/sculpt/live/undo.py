# SPDX-License-Identifier: GPL-3.0-or-later
"""States of the solver for Blender's undo steps.

Blender keeps the points of each undo step, but not the strain and stress of the clay. So the point
clouds store the number of their solver state. If that state is no longer available, the clay
starts from the same points, unstressed.
"""

from __future__ import annotations

from collections import OrderedDict

import bpy
from numpy.typing import NDArray

from ...model.clay_scene import clay_objects
from ...take.recorder import Mark

_MARK = "clay_state"
_MAX_BYTES = 256_000_000
"""Maximum total size of the states; the oldest is dropped first."""


class UndoStates:
    """The solver's state at each undo step of a session."""

    def __init__(self) -> None:
        self._states: OrderedDict[int, dict[str, NDArray]] = OrderedDict()
        self._marks: dict[int, Mark] = {}
        self._last = 0

    def keep(
        self,
        scene: bpy.types.Scene,
        state: dict[str, NDArray] | None,
        mark: Mark | None = None,
    ) -> None:
        """Store a state and mark the scene's clay with its number, just before an undo step.

        Args:
            scene: The session's scene.
            state: The solver's state; None if it cannot be read now.
            mark: The current moment in the take that is being recorded, if any.
        """
        self._last += 1
        if mark is not None:
            self._marks[self._last] = mark
        for item in clay_objects(scene):
            item.data[_MARK] = self._last
        if state is None:
            return
        self._states[self._last] = state
        while len(self._states) > 1 and self._bytes() > _MAX_BYTES:
            self._states.popitem(last=False)

    def state(self, scene: bpy.types.Scene) -> dict[str, NDArray] | None:
        """The solver state that belongs to the clay in Blender now; None if unknown."""
        return self._states.get(_number(scene))

    def mark(self, scene: bpy.types.Scene) -> Mark | None:
        """The moment in the take that belongs to the clay in Blender now; None if unknown."""
        return self._marks.get(_number(scene))

    def _bytes(self) -> int:
        return sum(part.nbytes for state in self._states.values() for part in state.values())


def _number(scene: bpy.types.Scene) -> int:
    """Number of the state of all clay; 0, which is never used, if the objects disagree."""
    numbers = {item.data.get(_MARK, 0) for item in clay_objects(scene)}
    return int(numbers.pop()) if len(numbers) == 1 else 0


def push_undo(message: str) -> None:
    """Push an undo step, if there is a window and thus an undo stack."""
    if not bpy.app.background and bpy.ops.ed.undo_push.poll():
        bpy.ops.ed.undo_push(message=message)
