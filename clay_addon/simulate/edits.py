# SPDX-License-Identifier: GPL-3.0-or-later
"""What a simulation asks of those who edit its clay between frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import bpy
import numpy as np
from numpy.typing import NDArray


class ClayEdits(Protocol):
    """Edits to the clay of a simulation, and which of its particles are there.

    The solver knows only the particles that are present. Every other one is shown at the place of a
    present particle, so that all frames have the same number of them.
    """

    colors: NDArray[np.float32]
    """Linear RGBA of all particles, shape [N, 4]."""
    lost: int
    """Number of particles that could not be added because there was no room."""

    def begin(self) -> None:
        """Go back to the beginning."""

    def bodies(self) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
        """Positions [Blender units] and colors of the present particles of each object."""

    def spread(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Rows of all particles, shape [N, 3], from those of the present ones, shape [P, 3]."""

    def is_due(self, after: float, until: float) -> bool:
        """Whether there are edits between two moments [frames], the second included."""

    def apply(self, after: float, until: float, positions: NDArray[np.float32]) -> bool:
        """Carry out the edits between two moments [frames].

        Args:
            after: The first moment, itself excluded.
            until: The second moment, included.
            positions: Positions of the present particles [Blender units], shape [P, 3].

        Returns:
            Whether particles came or went, so that the solver has to be built anew.
        """

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """The state of the edits; each key starts with ``scene_edit_``."""

    def restore(self, state: Mapping[str, NDArray[Any]]) -> bool:
        """Restore what `snapshot` gave; return whether other particles are present than before.

        Raises:
            KeyError: Something is missing in it.
            ValueError: It is of other clay.
        """


EditClay = Callable[[Sequence[bpy.types.Object], Sequence[NDArray[np.float32]], float], ClayEdits]
"""Makes the edits of a simulation from its clay objects, the world positions of their particles
[Blender units], shape [N, 3] each, and the length of a Blender unit [m]."""
