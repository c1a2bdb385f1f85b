# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender units and meters: the one place that knows how long a Blender unit is.

Lengths, points and velocities scale alike, so the same two functions turn all of them. A pose turns
only its translation: rotation and stretch have no unit.
"""

from __future__ import annotations

from typing import TypeVar

import bpy
import numpy as np
from numpy.typing import ArrayLike, NDArray

Lengths = TypeVar("Lengths", float, NDArray[np.float32], NDArray[np.float64])
"""A length, or points or velocities of any shape."""


def meters_per_unit(scene: bpy.types.Scene) -> float:
    """Length of one Blender unit in a scene [m]."""
    return float(scene.unit_settings.scale_length)


def to_meters(scene: bpy.types.Scene, values: Lengths) -> Lengths:
    """Turn lengths, points or velocities in Blender units into meters.

    Args:
        scene: The scene that the values belong to.
        values: Values [Blender units, or Blender units/s], of any shape.

    Returns:
        The same [m, or m/s], with the type they came in.
    """
    return values * meters_per_unit(scene)


def from_meters(scene: bpy.types.Scene, values: Lengths) -> Lengths:
    """Turn lengths, points or velocities in meters into Blender units; see `to_meters`."""
    return values / meters_per_unit(scene)


def pose_to_meters(scene: bpy.types.Scene, matrix: ArrayLike) -> NDArray[np.float64]:
    """Turn the translation of poses in Blender units into meters.

    Args:
        scene: The scene that the poses belong to.
        matrix: Poses, shape [..., 4, 4].

    Returns:
        A copy with the translation in meters, shape [..., 4, 4].
    """
    pose = np.array(matrix, np.float64)
    pose[..., :3, 3] = to_meters(scene, pose[..., :3, 3])
    return pose


def pose_from_meters(scene: bpy.types.Scene, matrix: ArrayLike) -> NDArray[np.float64]:
    """Turn the translation of poses in meters into Blender units; see `pose_to_meters`."""
    pose = np.array(matrix, np.float64)
    pose[..., :3, 3] = from_meters(scene, pose[..., :3, 3])
    return pose
