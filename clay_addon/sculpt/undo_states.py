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

from ..simulation import clay_objects

_MARK = "clay_state"
_MOST_BYTES = 256_000_000
"""So much is kept; the oldest state goes first."""


class UndoStates:
    """What the solver's state was at each undo step of a session."""

    def __init__(self) -> None:
        self._states: OrderedDict[int, dict[str, NDArray]] = OrderedDict()
        self._last = 0

    def keep(self, scene: bpy.types.Scene, state: dict[str, NDArray] | None) -> None:
        """Mark the scene's clay as being in a state, right before the undo step is made."""
        self._last += 1
        for item in clay_objects(scene):
            item.data[_MARK] = self._last
        if state is None:
            return
        self._states[self._last] = state
        while len(self._states) > 1 and self._bytes() > _MOST_BYTES:
            self._states.popitem(last=False)

    def state(self, scene: bpy.types.Scene) -> dict[str, NDArray] | None:
        """The state of the clay as Blender holds it now, if it is known."""
        numbers = {item.data.get(_MARK) for item in clay_objects(scene)}
        return self._states.get(numbers.pop()) if len(numbers) == 1 else None

    def _bytes(self) -> int:
        return sum(part.nbytes for state in self._states.values() for part in state.values())
