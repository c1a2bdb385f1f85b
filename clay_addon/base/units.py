# SPDX-License-Identifier: GPL-3.0-or-later
"""Conversion between Blender units and meters; no other module reads the unit scale.

Lengths, points and velocities scale alike, so the same two functions convert all of them. For a
pose only the translation is converted: rotation and scale have no unit.
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
    """Convert lengths, points or velocities from Blender units to meters.

    Args:
        scene: The scene that the values belong to.
        values: Values [Blender units, or Blender units/s], of any shape.

    Returns:
        The values [m, or m/s], with unchanged type and shape.
    """
    return values * meters_per_unit(scene)


def from_meters(scene: bpy.types.Scene, values: Lengths) -> Lengths:
    """Convert lengths, points or velocities from meters to Blender units; see `to_meters`."""
    return values / meters_per_unit(scene)


def pose_to_meters(scene: bpy.types.Scene, matrix: ArrayLike) -> NDArray[np.float64]:
    """Convert the translation of poses from Blender units to meters.

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
    """Convert the translation of poses from meters to Blender units; see `pose_to_meters`."""
    pose = np.array(matrix, np.float64)
    pose[..., :3, 3] = from_meters(scene, pose[..., :3, 3])
    return pose
