# SPDX-License-Identifier: GPL-3.0-or-later
"""Groups of nearly coincident points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .shells import connected_labels


def near_labels(points: NDArray[np.float64], distance: float) -> NDArray[np.int64]:
    """Label groups of points that are within a distance of each other, shape [N].

    Groups are chains: two distant points share a group if others bridge the gap.

    Args:
        points: Points [m], shape [N, 3].
        distance: Largest distance of neighbors in a group [m].
    """
    # Sorted along their widest axis, each point is compared only with those just behind it.
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
