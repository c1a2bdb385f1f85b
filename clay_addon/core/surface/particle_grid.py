# SPDX-License-Identifier: GPL-3.0-or-later
"""A grid over particles: nearest particles, averages of values, and label propagation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

_NEIGHBORS = np.stack(np.meshgrid(*[np.arange(-1, 2)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)


class ParticleGrid:
    """Finds the particles within one cell size of any point.

    Cells are numbered consecutively within the bounding box of the particles, which fits 64-bit
    integers up to two million cells per side.
    """

    def __init__(self, points: Floats, cell_size: float) -> None:
        """Sort the particles into cells.

        Args:
            points: Particle positions, shape [N, 3].
            cell_size: Side of a cell, and the maximum search distance.
        """
        self.particle_count = len(points)
        self._points = points
        self._cell_size = cell_size
        # With a margin of two cells, neighbors need no clipping.
        self._low = points.min(axis=0) - 2 * cell_size
        self._size = ((points.max(axis=0) - self._low) / cell_size).astype(np.int64) + 4
        keys = self._keys(self._cells(points))
        self._order = np.argsort(keys, kind="stable")
        self._cell_keys, self._first, self._count = np.unique(
            keys[self._order], return_index=True, return_counts=True
        )
        self._cell_of = np.searchsorted(self._cell_keys, keys)

    def nearest(self, queries: Floats) -> Indices:
        """Find the nearest particle of every query point.

        Args:
            queries: Points, shape [Q, 3].

        Returns:
            Particle indices, -1 if there is none within one cell size, shape [Q].
        """
        best = np.full(len(queries), -1)
        distance = np.full(len(queries), self._cell_size**2)
        for query, particle, squared in self._pairs(queries):
            closer = squared < distance[query]
            distance[query[closer]] = squared[closer]
            best[query[closer]] = particle[closer]
        return best

    def blend(self, queries: Floats, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Average particle values around points with a narrow kernel, for narrow but even borders.

        The weight is (1 - r^2 / R^2)^5, where R is the cell size. A narrower kernel would make
        borders follow the zigzag of the particles.

        Args:
            queries: Points, shape [Q, 3].
            values: One row per particle, shape [N, C].

        Returns:
            Values at the points, shape [Q, C]; the mean of all if no particle is near.
        """
        total = np.zeros((len(queries), values.shape[1]))
        weight = np.zeros(len(queries))
        for query, particle, squared in self._pairs(queries):
            share = (1 - squared / self._cell_size**2) ** 5
            weight += np.bincount(query, share, minlength=len(queries))
            for channel in range(values.shape[1]):
                total[:, channel] += np.bincount(
                    query, share * values[particle, channel], minlength=len(queries)
                )
        faint = np.flatnonzero(weight < 1e-12)
        nearest = self.nearest(queries[faint])
        total[faint] = np.where((nearest >= 0)[:, None], values[nearest], values.mean(axis=0))
        weight[faint] = 1.0
        return (total / weight[:, None]).astype(np.float32)

    def spread(self, labels: Indices) -> Indices:
        """Propagate labels, cell by cell, to particles that have none.

        Args:
            labels: One label per particle, -1 for none, shape [N].

        Returns:
            The labels, -1 only for particles not connected to any labeled one, shape [N].
        """
        cell_label = np.full(len(self._cell_keys), -1)
        known = labels >= 0
        cell_label[self._cell_of[known]] = labels[known]
        strides = np.array([self._size[1] * self._size[2], self._size[2], 1])
        front = np.flatnonzero(cell_label >= 0)
        while len(front):
            reached = []
            for step in _NEIGHBORS @ strides:
                neighbor = self._cell_keys[front] + step
                place = np.minimum(
                    np.searchsorted(self._cell_keys, neighbor), len(self._cell_keys) - 1
                )
                new = (self._cell_keys[place] == neighbor) & (cell_label[place] < 0)
                cell_label[place[new]] = cell_label[front[new]]
                reached.append(place[new])
            front = np.unique(np.concatenate(reached))
        return np.where(known, labels, cell_label[self._cell_of])

    def _cells(self, points: Floats) -> Indices:
        cells: Indices = np.floor((points - self._low) / self._cell_size).astype(np.int64)
        return cells

    def _keys(self, cells: Indices) -> Indices:
        keys: Indices = (cells[:, 0] * self._size[1] + cells[:, 1]) * self._size[2] + cells[:, 2]
        return keys

    def _pairs(self, queries: Floats) -> Iterator[tuple[Indices, Indices, Floats]]:
        """Yield (query, particle, squared distance) for all pairs within one cell size."""
        cells = self._cells(queries)
        for step in _NEIGHBORS:
            neighbor = cells + step
            inside = ((neighbor >= 0) & (neighbor < self._size)).all(axis=1)
            query = np.flatnonzero(inside)
            keys = self._keys(neighbor[inside])
            place = np.minimum(np.searchsorted(self._cell_keys, keys), len(self._cell_keys) - 1)
            hit = self._cell_keys[place] == keys
            query, place = query[hit], place[hit]
            for turn in range(int(self._count[place].max()) if len(place) else 0):
                more = self._count[place] > turn
                query, place = query[more], place[more]
                particle = self._order[self._first[place] + turn]
                squared = ((queries[query] - self._points[particle]) ** 2).sum(axis=1)
                near = squared < self._cell_size**2
                yield query[near], particle[near], squared[near]
