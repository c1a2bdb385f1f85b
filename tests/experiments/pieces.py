# SPDX-License-Identifier: GPL-3.0-or-later
"""Connected pieces of particles."""

import numpy as np
from numpy.typing import NDArray

REACH = 2.0
"""Particles closer than this are connected, in spacings: beyond it no bond acts."""


def pieces(
    points: NDArray[np.floating], spacing: float, *, reach: float = REACH
) -> list[NDArray[np.intp]]:
    """Groups of particles with no gap wider than ``reach`` spacings, the largest first.

    Args:
        points: Particle positions [m], shape [N, 3].
        spacing: Distance between neighboring particles at rest [m].
        reach: Widest gap within a piece, in spacings.

    Returns:
        Particle indices of each piece.
    """
    first, second = close_pairs(np.asarray(points, np.float64), reach * spacing)
    label = np.arange(len(points))
    while True:
        lowest = np.minimum(label[first], label[second])
        updated = label.copy()
        np.minimum.at(updated, first, lowest)
        np.minimum.at(updated, second, lowest)
        updated = updated[updated]
        if np.array_equal(updated, label):
            break
        label = updated
    groups = [np.flatnonzero(label == root) for root in np.unique(label)]
    return sorted(groups, key=len, reverse=True)


def close_pairs(
    points: NDArray[np.float64], distance: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs closer than ``distance`` [m], each once, first index below second."""
    firsts, seconds = [np.zeros(0, np.intp)], [np.zeros(0, np.intp)]
    for start in range(0, len(points), 512):
        rows = points[start : start + 512]
        apart = ((rows[:, None] - points[None]) ** 2).sum(-1)
        one, two = np.nonzero(apart < distance**2)
        one += start
        firsts.append(one[one < two])
        seconds.append(two[one < two])
    return np.concatenate(firsts), np.concatenate(seconds)
