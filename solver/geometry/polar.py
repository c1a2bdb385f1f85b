# SPDX-License-Identifier: GPL-3.0-or-later
"""Splitting a linear map into a rotation and a stretch."""

import numpy as np
from numpy.typing import NDArray


def rotation_and_stretch(
    linear: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Polar decomposition: ``linear = rotation @ stretch``; a mirroring goes into the stretch.

    Args:
        linear: Shape [3, 3], not flat.
    """
    left, scales, right = np.linalg.svd(linear)
    rotation = left @ right
    stretch = right.T @ np.diag(scales) @ right
    return (rotation, stretch) if np.linalg.det(rotation) > 0 else (-rotation, -stretch)
