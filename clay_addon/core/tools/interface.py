# SPDX-License-Identifier: GPL-3.0-or-later
"""What a live session asks of what the mouse holds."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .edits import Edit
from .settings import ToolMesh


class Tools(Protocol):
    """What the mouse holds; see `Brush`."""

    @property
    def mesh_key(self) -> Hashable:
        """Changes when `meshes` do."""

    @property
    def stroking(self) -> bool:
        """Whether a stroke is under way."""

    def meshes(self) -> Sequence[ToolMesh]:
        """What collides with the clay."""

    def poses(self, duration: float) -> Sequence[tuple[NDArray[np.float64], bool]]:
        """Where each mesh is after so many seconds, and whether the clay feels it."""

    def take_edits(self) -> Sequence[Edit]:
        """What to do to the clay beside that, since the last call."""


class NoTools:
    """Nothing in the mouse: tracked hands and colliders only."""

    mesh_key: Hashable = ()
    stroking = False

    def meshes(self) -> Sequence[ToolMesh]:
        """None."""
        return ()

    def poses(self, duration: float) -> Sequence[tuple[NDArray[np.float64], bool]]:
        """None."""
        return ()

    def take_edits(self) -> Sequence[Edit]:
        """None."""
        return ()
