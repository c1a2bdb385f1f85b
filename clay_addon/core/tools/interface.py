# SPDX-License-Identifier: GPL-3.0-or-later
"""What a live session asks of the tool in the mouse."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .edits import Edit
from .settings import ToolMesh


class Tools(Protocol):
    """A tool in the mouse; see `Brush`."""

    @property
    def mesh_key(self) -> Hashable:
        """Changes when `meshes` do."""

    @property
    def stroking(self) -> bool:
        """Whether a stroke is under way."""

    def meshes(self) -> Sequence[ToolMesh]:
        """What collides with the clay."""

    def poses(
        self, duration: float, positions: NDArray[np.float32]
    ) -> Sequence[tuple[NDArray[np.float64], bool]]:
        """Where each mesh is at the end of the next step, and whether the clay feels it.

        Args:
            duration: Simulated time of the step [s].
            positions: All particles as shown, world [Blender units], shape [N, 3].
        """

    def take_edits(self) -> Sequence[Edit]:
        """Clay to add, remove or paint since the last call, in order."""


class NoTools:
    """Nothing in the mouse: tracked hands and colliders only."""

    mesh_key: Hashable = ()
    stroking = False

    def meshes(self) -> Sequence[ToolMesh]:
        """None."""
        return ()

    def poses(
        self, duration: float, positions: NDArray[np.float32]
    ) -> Sequence[tuple[NDArray[np.float64], bool]]:
        """None."""
        return ()

    def take_edits(self) -> Sequence[Edit]:
        """None."""
        return ()
