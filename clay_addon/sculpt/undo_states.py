# SPDX-License-Identifier: GPL-3.0-or-later
"""States of the solver for Blender's undo steps.

Blender keeps the points of each undo step; how they are stretched and pressed it does not know.
The points carry a number that tells which state is theirs. Where that state is no longer there,
the clay starts at rest, from the same points.
"""

from __future__ import annotations

from collections import OrderedDict

import bpy
from numpy.typing import NDArray

from ..model.clay_scene import clay_objects
from ..take.take import Mark

_MARK = "clay_state"
_MOST_BYTES = 256_000_000
"""So much is kept; the oldest state goes first."""


class UndoStates:
    """What the solver's state was at each undo step of a session."""

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
        """Mark the scene's clay as being in a state, right before the undo step is made.

        Args:
            scene: The session's.
            state: The solver's; None where it is not to be had.
            mark: The moment of the take that is recorded.
        """
        self._last += 1
        if mark is not None:
            self._marks[self._last] = mark
        for item in clay_objects(scene):
            item.data[_MARK] = self._last
        if state is None:
            return
        self._states[self._last] = state
        while len(self._states) > 1 and self._bytes() > _MOST_BYTES:
            self._states.popitem(last=False)

    def state(self, scene: bpy.types.Scene) -> dict[str, NDArray] | None:
        """The state of the clay as Blender holds it now, if it is known."""
        return self._states.get(_number(scene))

    def mark(self, scene: bpy.types.Scene) -> Mark | None:
        """The moment of the take that the clay is of as Blender holds it now, if it is known."""
        return self._marks.get(_number(scene))

    def _bytes(self) -> int:
        return sum(part.nbytes for state in self._states.values() for part in state.values())


def _number(scene: bpy.types.Scene) -> int:
    """Number of the state of all clay; 0, which there is none of, where objects differ."""
    numbers = {item.data.get(_MARK, 0) for item in clay_objects(scene)}
    return int(numbers.pop()) if len(numbers) == 1 else 0
