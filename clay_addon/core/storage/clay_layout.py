# SPDX-License-Identifier: GPL-3.0-or-later
"""Ranges of rows in the solver's arrays that belong to each clay object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Kind = TypeVar("Kind", bound=np.generic)


@dataclass(frozen=True)
class ClaySlice:
    """The consecutive particles of one clay object."""

    name: str
    """Name of the object."""
    count: int
    """Number of particles."""


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
        """Particle counts of the objects."""
        return [part.count for part in self]

    @property
    def particle_count(self) -> int:
        """Total number of particles."""
        return sum(self.counts)

    def split(self, rows: NDArray[Kind]) -> list[NDArray[Kind]]:
        """Split an array into the rows of each object.

        Args:
            rows: One row per particle, shape [N, ...].

        Returns:
            A view of the rows of each object.

        Raises:
            ValueError: The number of rows is not the number of particles.
        """
        if len(rows) != self.particle_count:
            raise ValueError(f"There are {len(rows)} rows for {self.particle_count} particles.")
        ends = np.cumsum(self.counts, dtype=np.int64)
        return [rows[end - part.count : end] for part, end in zip(self, ends, strict=True)]

    def join(self, parts: Sequence[NDArray[Kind]]) -> NDArray[Kind]:
        """Concatenate the rows of all objects, the inverse of `split`.

        Args:
            parts: The rows of each object, in order.

        Raises:
            ValueError: The number of rows of an object is not its number of particles.
        """
        counts = [len(part) for part in parts]
        if counts != self.counts:
            raise ValueError(f"The parts have {counts} rows, but the objects have {self.counts}.")
        return np.concatenate(parts)
