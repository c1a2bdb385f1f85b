# SPDX-License-Identifier: GPL-3.0-or-later
"""Which rows of a solver's arrays belong to which clay object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Kind = TypeVar("Kind", bound=np.generic)


@dataclass(frozen=True)
class ClaySlice:
    """One clay object's part of every frame."""

    name: str
    """The object's name."""
    count: int
    """Number of its particles; the objects follow each other in the order of the list."""


class ClayLayout(tuple[ClaySlice, ...]):
    """The clay objects of a simulation, in the order of their particles.

    Example:
        >>> layout = ClayLayout([ClaySlice("Clay", 3), ClaySlice("Lump", 2)])
        >>> clay, lump = layout.split(solver.positions())
    """

    __slots__ = ()

    @property
    def names(self) -> list[str]:
        """Names of the objects."""
        return [part.name for part in self]

    @property
    def counts(self) -> list[int]:
        """Number of particles of each object."""
        return [part.count for part in self]

    @property
    def particle_count(self) -> int:
        """Number of particles of all objects."""
        return sum(self.counts)

    def split(self, rows: NDArray[Kind]) -> list[NDArray[Kind]]:
        """Give each object its rows.

        Args:
            rows: One row a particle, shape [N, ...].

        Returns:
            A view of the rows of each object.

        Raises:
            ValueError: There are more or fewer rows than particles.
        """
        if len(rows) != self.particle_count:
            raise ValueError(f"There are {len(rows)} rows for {self.particle_count} particles.")
        ends = np.cumsum(self.counts, dtype=np.int64)
        return [rows[end - part.count : end] for part, end in zip(self, ends, strict=True)]

    def join(self, parts: Sequence[NDArray[Kind]]) -> NDArray[Kind]:
        """Put the rows of each object one after another; undoes `split`.

        Args:
            parts: The rows of each object, in order.

        Raises:
            ValueError: An object has more or fewer rows than particles.
        """
        counts = [len(part) for part in parts]
        if counts != self.counts:
            raise ValueError(f"The parts have {counts} rows, but the objects {self.counts}.")
        return np.concatenate(parts)
