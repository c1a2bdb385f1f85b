# SPDX-License-Identifier: GPL-3.0-or-later
"""Random sets of foci that drives are judged by, as Fushimi et al. do (Diff-PAT, 2021)."""

import numpy as np
from numpy.typing import NDArray

Targets = tuple[NDArray[np.float64], NDArray[np.float64]]

APART = 0.010
"""Foci of a set are farther apart than this [m]: some wavelengths."""


def random_targets(
    count: int, *, fewest: int = 1, most: int = 32, loudest: float = 1200.0, seed: int = 1
) -> list[Targets]:
    """Sets of foci in a box above an array.

    Args:
        count: How many sets.
        fewest: Foci in a set, at least.
        most: And at most.
        loudest: Pressure is drawn from .3 to 1 of this over √K [Pa], K being the foci of the set.
        seed: Of the drawing.

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
            if (np.linalg.norm(points - point, axis=1) > APART).all():
                points = np.vstack((points, point))
        sets.append((points, random.uniform(0.3, 1.0, size) * loudest / np.sqrt(size)))
    return sets
