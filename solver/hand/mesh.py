# SPDX-License-Identifier: GPL-3.0-or-later
"""Generates the default hand's watertight mesh from its joints, their radii and a pose.

The mesh is a surface net of the hand's signed distance, relaxed along the surface and projected
back onto it.
"""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..geometry.surface_net import surface_net
from .proportions import AVERAGE, REFERENCE_LENGTH, HandProportions
from .shape import HandPose, named_pose, reference_shape, scale_factors
from .skin import skin_distance

__all__ = ["hand_mesh"]

Array = NDArray[np.float64]


def hand_mesh(
    side: str = "right",
    *,
    length: float = REFERENCE_LENGTH,
    pose: str | HandPose = "flat",
    edge_length: float | None = None,
    proportions: HandProportions = AVERAGE,
) -> tuple[Array, NDArray[np.int32]]:
    """Mesh a hand as one closed surface.

    Args:
        side: "right" or "left"; the left hand is the mirror image in X.
        length: From the wrist joint to the tip of the straight middle finger [m].
        pose: A name in POSES, or joint angles.
        edge_length: Typical edge of a triangle [m]; by default 2.4 % of the hand's length.
        proportions: Sizes of the hand's parts relative to each other.

    Returns:
        Vertices [m], shape [V, 3], and triangles that wind counter-clockwise seen from outside,
        shape [F, 3].

    Raises:
        ValueError: The side or the pose is unknown, the length is not positive, or the edge is too
            long to resolve the gaps between fingers.
    """
    factor = scale_factors(side, length)
    edge = 0.024 * REFERENCE_LENGTH if edge_length is None else edge_length / factor[1]
    if not 0.001 <= edge <= 0.006:
        raise ValueError(
            f"edge_length must be between {0.001 * factor[1]:.4f} and {0.006 * factor[1]:.4f} m "
            f"for a hand of {length} m, not {edge_length}."
        )
    shape = reference_shape(named_pose(pose), proportions)
    corners = np.array(list(shape.joints.values()))
    vertices, faces = surface_net(
        partial(skin_distance, shape=shape), corners.min(axis=0), corners.max(axis=0), edge
    )
    if factor[0] < 0.0:
        faces = faces[:, ::-1]
    return vertices * factor, np.ascontiguousarray(faces)
