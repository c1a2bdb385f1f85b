# SPDX-License-Identifier: GPL-3.0-or-later
"""Interpolates a hand's bones over a step: rotations by slerp, positions linearly."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..geometry.rotations import (
    conjugate,
    matrices_from_quaternions,
    product,
    quaternions_from_matrices,
    rotation_and_stretch,
    slerp,
)

if TYPE_CHECKING:
    from ..hand.rig import HandRig

Array = NDArray[np.float64]


class BonePath:
    """Poses of bones between the ends of two steps.

    Args:
        rest: Rest matrix of each bone, bone to world, shape [B, 4, 4].
    """

    def __init__(self, rest: Array) -> None:
        self._rest_inverse = np.linalg.inv(rest)
        self._rest_rotation = quaternions_from_matrices(_split(rest[:, :3, :3])[0])
        self.start = rest.copy()
        """Poses at the end of the last step, shape [B, 4, 4]."""
        self.end = rest.copy()
        """Poses at the end of this step."""
        self._prepare()

    def aim(self, end: Array) -> None:
        """Set the poses at the end of this step, shape [B, 4, 4]."""
        self.end = end.copy()
        self._prepare()

    def arrive(self) -> None:
        """Start the next path at the end of this one."""
        self.start = self.end.copy()

    def _prepare(self) -> None:
        first, self._first_stretch = _split(self.start[:, :3, :3])
        last, self._last_stretch = _split(self.end[:, :3, :3])
        self._first_rotation = quaternions_from_matrices(first)
        self._last_rotation = quaternions_from_matrices(last)

    def poses(self, fraction: float) -> tuple[Array, Array]:
        """Poses of the bones after a fraction of the step.

        Returns:
            Poses, shape [B, 4, 4], and their rotations from rest as quaternions, shape [B, 4].
        """
        rotation = slerp(self._first_rotation, self._last_rotation, fraction)
        stretch = self._first_stretch + (self._last_stretch - self._first_stretch) * fraction
        poses = np.zeros_like(self.end)
        poses[:, :3, :3] = matrices_from_quaternions(rotation) @ stretch
        poses[:, :3, 3] = self.start[:, :3, 3] + fraction * (
            self.end[:, :3, 3] - self.start[:, :3, 3]
        )
        poses[:, 3, 3] = 1.0
        return poses, product(rotation, conjugate(self._rest_rotation))

    def skinning_matrices(self, poses: Array) -> Array:
        """Each bone's map from rest to current world positions, shape [B, 4, 4]."""
        return poses @ self._rest_inverse


def _split(linear: Array) -> tuple[Array, Array]:
    """Rotations and stretches of linear maps, shape [B, 3, 3] each."""
    gram = np.swapaxes(linear, 1, 2) @ linear
    rotation, stretch = linear.copy(), np.tile(np.eye(3), (len(linear), 1, 1))
    # Most bones are rigid, up to rounding. A mirrored one is not, though its axes have length 1:
    # what mirrors belongs to the stretch.
    odd = (np.abs(gram - np.eye(3)).max((1, 2)) > 1e-6) | (np.linalg.det(linear) < 0.0)
    for bone in np.flatnonzero(odd):
        rotation[bone], stretch[bone] = rotation_and_stretch(linear[bone])
    return rotation, stretch


def posed_skin(rig: HandRig, bones: Array) -> Array:
    """The skin of a hand whose bones are in a pose, and whose flesh nothing presses, shape [V, 3].

    Args:
        rig: The hand.
        bones: World from each bone's own coordinates, shape [B, 4, 4].
    """
    path = BonePath(rig.bone_rest)
    path.start = bones.copy()
    path.aim(bones)
    skinning = path.skinning_matrices(path.poses(1.0)[0])
    carried = np.einsum("nk,nkij->nij", rig.node_weights, skinning[rig.node_bones])
    nodes = np.einsum("nij,nj->ni", carried[:, :3, :3], rig.nodes) + carried[:, :3, 3]
    corners = nodes[rig.tetrahedra[rig.vertex_tetrahedron]]
    return np.einsum("vk,vki->vi", rig.vertex_weights, corners)
