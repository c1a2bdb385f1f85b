# SPDX-License-Identifier: GPL-3.0-or-later
"""Rotations and frames of tools."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def limited(vector: NDArray[np.float64], most: float) -> NDArray[np.float64]:
    """A vector, no longer than a length."""
    size = float(np.linalg.norm(vector))
    return vector if size <= most else vector * (most / size)


def tangent_of(
    direction: NDArray[np.float64], normal: NDArray[np.float64], otherwise: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Unit vector of a direction across a unit normal; of another one where it has none."""
    for way in (direction, otherwise, np.eye(3)[np.argmin(np.abs(normal))]):
        flat = way - (way @ normal) * normal
        size = float(np.linalg.norm(flat))
        if size > 1e-3 * max(float(np.linalg.norm(way)), 1e-9):
            return np.asarray(flat / size)
    raise AssertionError("an axis is across every normal")


def frame_of(normal: NDArray[np.float64], tangent: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation whose Z is a unit normal and whose Y is as near to a tangent as can be, [3, 3]."""
    y = tangent_of(tangent, normal, tangent)
    return np.column_stack((np.cross(y, normal), y, normal))


def turn_about(axis: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """Rotation about a unit axis (Rodrigues), shape [3, 3]."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def turned_towards(
    rotation: NDArray[np.float64], target: NDArray[np.float64], most: float
) -> NDArray[np.float64]:
    """A rotation turned towards another by an angle at most [rad], shape [3, 3]."""
    way = target @ rotation.T
    axis = np.array([way[2, 1] - way[1, 2], way[0, 2] - way[2, 0], way[1, 0] - way[0, 1]])
    size = float(np.linalg.norm(axis))
    angle = float(np.arctan2(0.5 * size, 0.5 * (np.trace(way) - 1.0)))
    if angle <= most:
        return target
    if size < 1e-9:
        # Half a turn has no axis of its own; about the handle is the shortest way for a tool.
        return turn_about(rotation[:, 2], most) @ rotation
    return turn_about(axis / size, most) @ rotation
