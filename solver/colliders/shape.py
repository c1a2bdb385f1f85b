# SPDX-License-Identifier: GPL-3.0-or-later
"""Pose and shape of a mesh collider, and its motion between two of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..geometry.rotations import quaternions_from_matrices, rotation_and_stretch, slerp
from ..scene.scene import MeshCollider


@dataclass
class ColliderShape:
    """Pose and shape of a mesh collider."""

    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]
    vertices: NDArray[np.float64]
    """Stretched, in the frame that moves with the collider [m], shape [V, 3]."""
    corners: NDArray[np.float64]
    """Corners of the vertices' bounding box [m], shape [8, 3]."""
    orientation: float
    """-1 if the pose mirrors, else 1."""
    version: int
    """`MeshCollider.shape_version`."""

    def moved(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Transform points from the moving frame to the world [m], shape [N, 3]."""
        return points @ self.rotation.T + self.translation


def shape_of(collider: MeshCollider, before: ColliderShape | None) -> ColliderShape:
    """Split a pose into rotation, translation and stretched vertices (polar decomposition)."""
    translation = collider.pose[:3, 3].copy()
    if before and before.version == collider.shape_version:
        return replace(before, translation=translation)
    rotation, stretch = rotation_and_stretch(collider.pose[:3, :3])
    vertices = collider.vertices @ stretch.T
    if before and vertices.shape == before.vertices.shape:
        tolerance = 1e-6 * box_diagonal(before.corners)
        if np.abs(vertices - before.vertices).max() <= tolerance:
            # Only rotated: keep the same array, so that the mesh need not be refitted.
            vertices = before.vertices
    orientation = 1.0 if np.linalg.det(stretch) > 0.0 else -1.0
    version = collider.shape_version
    return ColliderShape(
        rotation, translation, vertices, box_corners(vertices), orientation, version
    )


_UPPER = np.array([[(k >> axis) & 1 for axis in range(3)] for k in range(8)], bool)


def box_corners(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Corners of the bounding box of vertices [m], shape [8, 3]."""
    # NumPy finds the extremes of three long rows much faster than those of many short ones.
    axes = vertices.T.copy()
    return np.where(_UPPER, axes.max(1), axes.min(1))


def poses_between(start: ColliderShape, end: ColliderShape, substeps: int) -> NDArray[np.float32]:
    """Interpolate poses linearly and at constant angular velocity, shape [S + 1, 7]."""
    fraction = np.linspace(0.0, 1.0, substeps + 1)[:, None]
    first = quaternions_from_matrices(start.rotation)
    last = first if end.rotation is start.rotation else quaternions_from_matrices(end.rotation)
    turn = slerp(first, last, fraction[:, 0])
    place = start.translation + (end.translation - start.translation) * fraction
    return np.concatenate([place, turn], axis=1).astype(np.float32)


def box_diagonal(corners: NDArray[np.float64]) -> float:
    """Length of a box's diagonal [m]."""
    return float(np.linalg.norm(corners[-1] - corners[0]))


def longest(vectors: NDArray[np.float64]) -> float:
    """Length of the longest vector [m]."""
    return float(np.sqrt(np.einsum("ij,ij->i", vectors, vectors).max()))
