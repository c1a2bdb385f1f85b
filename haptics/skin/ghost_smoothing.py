# SPDX-License-Identifier: GPL-3.0-or-later
"""Smoothing over neighboring ghosts of the skin that preserves force and uniform pressure."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

_REACH = 2.5
"""Maximum distance of neighbors, in standard deviations of the Gaussian."""
_BALANCING_SWEEPS = 30

Real = NDArray[np.float64]


class GhostSmoothing:
    """Spreads a pressure over the skin by a Gaussian of one ghost spacing.

    The kernel is balanced (Sinkhorn) so that it preserves ∫ p dA and leaves a uniform pressure
    unchanged, also at the edges of the skin. Ghosts whose normals differ by more than 90° are not
    neighbors: pressure on a finger pad is not felt on the nail.

    Neighbors are found once, in the hand's first pose, in about 0.1 s for 2,000 ghosts; skin keeps
    its neighbors when it moves.

    Args:
        positions: Positions of the ghosts [m], shape [G, 3].
        normals: Their outward unit normals, shape [G, 3].
        areas: Area of skin that each represents [m²], shape [G]; ghosts with 0 are left out.
    """

    def __init__(self, positions: Real, normals: Real, areas: Real) -> None:
        self._count = len(areas)
        surface = np.flatnonzero(areas > 0.0)
        self._second = np.zeros(0, np.intp)
        self._factor = np.zeros(0)
        self._starts = np.zeros(0, np.intp)
        self._rows = np.zeros(0, np.intp)
        if len(surface) == 0:
            return
        area = areas[surface]
        spacing = float(np.sqrt(np.median(area)))
        first, second, square = _pairs(positions[surface], normals[surface], _REACH * spacing)
        weight = np.exp(-0.5 * square / spacing**2)
        balance = np.ones(len(surface))
        for _ in range(_BALANCING_SWEEPS):
            reached = np.bincount(first, weight * (balance * area)[second], minlength=len(surface))
            balance = np.sqrt(balance / reached)
        self._second = surface[second]
        self._factor = weight * balance[first] * balance[second] * area[second]
        # Each ghost's own factor corrects the force error left by rounding and few sweeps.
        kept = np.bincount(second, self._factor * area[first], minlength=len(surface)) / area
        own = first == second
        self._factor[own] += (1.0 - kept)[first[own]]
        self._starts = np.searchsorted(first, np.arange(len(surface)))
        self._rows = surface
        self._buffer = np.empty(len(first))

    def smooth(self, pressures: Real) -> Real:
        """Smoothed pressures [Pa], shape [G]; 0 for ghosts without area."""
        result = np.zeros(self._count)
        if len(self._rows) and pressures.any():
            # One buffer for all frames, because allocating it costs more than the sums.
            np.take(pressures, self._second, out=self._buffer, mode="clip")
            self._buffer *= self._factor
            result[self._rows] = np.add.reduceat(self._buffer, self._starts)
        return result


def _pairs(
    positions: Real, normals: Real, reach: float
) -> tuple[NDArray[np.intp], NDArray[np.intp], Real]:
    """Pairs of neighbors on the same side of the skin, in both orders and each ghost with itself.

    Returns:
        First index, second index and squared distance [m²], sorted by the first, shape [N].
    """
    cell = ((positions - positions.min(0)) / reach).astype(np.int64) + 1
    size = cell.max(0) + 2
    key = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
    order = np.argsort(key, kind="stable")
    ranked = key[order]
    found = []
    for step in product((-1, 0, 1), repeat=3):
        neighbor_key = key + (step[0] * size[1] + step[1]) * size[2] + step[2]
        low = np.searchsorted(ranked, neighbor_key, "left")
        count = np.searchsorted(ranked, neighbor_key, "right") - low
        first = np.repeat(np.arange(len(key)), count)
        place = np.arange(len(first)) - np.repeat(np.cumsum(count) - count, count)
        second = order[place + np.repeat(low, count)]
        square = np.square(positions[first] - positions[second]).sum(1)
        near = square < reach * reach
        near &= np.einsum("ni,ni->n", normals[first], normals[second]) > 0.0
        near |= first == second
        found.append((first[near], second[near], square[near]))
    first, second, square = (np.concatenate(part) for part in zip(*found, strict=True))
    order = np.lexsort((second, first))
    return first[order], second[order], square[order]
