# SPDX-License-Identifier: GPL-3.0-or-later
"""Which points are all but at one place."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .shells import connected_labels


def near_labels(points: NDArray[np.float64], distance: float) -> NDArray[np.int64]:
    """Number the groups of points that are within a distance of each other, shape [N].

    Groups are chains: two points far apart are in one if others lie between them.

    Args:
        points: [m], shape [N, 3].
        distance: [m].
    """
    # Sorted along the axis on which they are spread widest, each meets only those right behind.
    axis = int(np.argmax(np.ptp(points, axis=0)))
    order = np.argsort(points[:, axis], kind="stable")
    ordered = points[order]
    along = ordered[:, axis]
    last = np.searchsorted(along, along + distance, side="right")
    pairs = []
    for step in range(1, int((last - np.arange(len(points))).max(initial=1))):
        first = np.flatnonzero(np.arange(len(points)) + step < last)
        gap = np.linalg.norm(ordered[first + step] - ordered[first], axis=1)
        first = first[gap <= distance]
        pairs.append(np.stack([order[first], order[first + step]], 1))
    return connected_labels(np.concatenate([np.zeros((0, 2), np.int64), *pairs]), len(points))
