# SPDX-License-Identifier: GPL-3.0-or-later
"""The path of a hand's bones through a step: rotations turn evenly, joints go straight."""

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
    """Bones between the poses of two steps.

    Args:
        rest: World from each bone's own coordinates at rest, shape [B, 4, 4].
    """

    def __init__(self, rest: Array) -> None:
        self._rest_inverse = np.linalg.inv(rest)
        self._rest_turn = quaternions_from_matrices(_split(rest[:, :3, :3])[0])
        self.start = rest.copy()
        """Poses at the end of the last step, shape [B, 4, 4]."""
        self.end = rest.copy()
        """Poses at the end of this step."""
        self._prepare()

    def aim(self, end: Array) -> None:
        """Plan the path from the current poses to the next ones, shape [B, 4, 4]."""
        self.end = end.copy()
        self._prepare()

    def arrive(self) -> None:
        """Start the next path at the end of this one."""
        self.start = self.end.copy()

    def _prepare(self) -> None:
        first, self._first_stretch = _split(self.start[:, :3, :3])
        last, self._last_stretch = _split(self.end[:, :3, :3])
        self._first_turn = quaternions_from_matrices(first)
        self._last_turn = quaternions_from_matrices(last)

    def poses(self, fraction: float) -> tuple[Array, Array]:
        """Where bones are after a fraction of the step.

        Returns:
            Poses, shape [B, 4, 4], and their rotations from rest as quaternions, shape [B, 4].
        """
        turn = slerp(self._first_turn, self._last_turn, fraction)
        stretch = self._first_stretch + (self._last_stretch - self._first_stretch) * fraction
        poses = np.zeros_like(self.end)
        poses[:, :3, :3] = matrices_from_quaternions(turn) @ stretch
        poses[:, :3, 3] = self.start[:, :3, 3] + fraction * (
            self.end[:, :3, 3] - self.start[:, :3, 3]
        )
        poses[:, 3, 3] = 1.0
        return poses, product(turn, conjugate(self._rest_turn))

    def turns(self, poses: Array) -> Array:
        """Current world from world at rest, for each bone, shape [B, 4, 4]."""
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
    turns = path.turns(path.poses(1.0)[0])
    carried = np.einsum("nk,nkij->nij", rig.node_weights, turns[rig.node_bones])
    nodes = np.einsum("nij,nj->ni", carried[:, :3, :3], rig.nodes) + carried[:, :3, 3]
    corners = nodes[rig.tetrahedra[rig.vertex_tetrahedron]]
    return np.einsum("vk,vki->vi", rig.vertex_weights, corners)
