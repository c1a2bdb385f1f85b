# SPDX-License-Identifier: GPL-3.0-or-later
"""Random sets of foci to evaluate drives with, as in Fushimi et al. (Diff-PAT, 2021)."""

import numpy as np
from numpy.typing import NDArray

Targets = tuple[NDArray[np.float64], NDArray[np.float64]]

MIN_DISTANCE = 0.010
"""Minimum distance between the foci of a set [m]: a little more than a wavelength."""


def random_targets(
    count: int, *, fewest: int = 1, most: int = 32, loudest: float = 1200.0, seed: int = 1
) -> list[Targets]:
    """Sets of foci in a box above an array.

    Args:
        count: Number of sets.
        fewest: Minimum number of foci in a set.
        most: Maximum number of foci in a set.
        loudest: Pressures are drawn from 0.3 to 1 times this over √K [Pa], for a set of K foci.
        seed: Random seed.

    Returns:
        Positions [m], shape [K, 3], and pressures [Pa], shape [K], of each set.
    """
    random = np.random.default_rng(seed)
    sets = []
    for _ in range(count):
        size = int(random.integers(fewest, most + 1))
        points = np.zeros((0, 3))
        while len(points) < size:
            point = random.uniform((-0.06, -0.06, 0.15), (0.06, 0.06, 0.25))
            if (np.linalg.norm(points - point, axis=1) > MIN_DISTANCE).all():
                points = np.vstack((points, point))
        sets.append((points, random.uniform(0.3, 1.0, size) * loudest / np.sqrt(size)))
    return sets
