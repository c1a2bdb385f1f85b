# SPDX-License-Identifier: GPL-3.0-or-later
"""Springs between the tracked and the simulated pose, through which bones yield to the clay.

The user holds each joint with a certain stiffness. The clay's forces on the flesh rotate joints,
and move the roots of the skeleton, away from the target pose, as in *Natural Tactile Interaction
with Virtual Clay* (Barreiro, Torres and Otaduy, WHC 2021, sections III-D and IV-A), where the
forces on the tetrahedra are fed back to the hand.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry.rotations import (
    matrices_from_rotation_vectors,
    product,
    quaternions_from_matrices,
)
from ..hand.rig import HandRig

Array = NDArray[np.float64]

HOLD_TIME = 0.05
"""Time constant with which joints follow forces [s]: limbs have mass, and muscles damp."""


def held_part(time_step: float) -> float:
    """Fraction of the change to equilibrium that joints complete in a time step [s]."""
    return time_step / (time_step + HOLD_TIME)


NEGLIGIBLE = 1.0e-6
"""Unloaded joints are reset to their pose when they are this close to it [rad, m]."""
MIN_SHARE = 0.5
"""A node belongs to a bone if the total weight of the bone and its descendants exceeds this."""


class Hold:
    """The springs of one hand's joints.

    They are chosen so that a force perpendicular to a straight finger moves its tip by the force
    over ``stiffness``: each joint of the longest chain, and the root, contributes an equal share.

    Args:
        rig: The hand.
        stiffness: Stiffness of a fingertip [N/m].
    """

    def __init__(self, rig: HandRig, stiffness: float) -> None:
        count = len(rig.bone_names)
        self.parent = rig.bone_parent
        self._levels = _levels(rig.bone_parent)
        self._roots = rig.bone_parent < 0
        carried = np.zeros((len(rig.nodes), count))
        np.add.at(carried, (np.arange(len(rig.nodes))[:, None], rig.node_bones), rig.node_weights)
        for bone in range(count - 1, -1, -1):
            if rig.bone_parent[bone] >= 0:
                carried[:, rig.bone_parent[bone]] += carried[:, bone]
        self._carried = carried
        """Weight of each bone and its descendants at each node, shape [N, B]."""
        away = np.linalg.norm(rig.nodes[:, None] - rig.bone_rest[None, :, :3, 3], axis=2)
        lever = np.where(carried > MIN_SHARE, away, 0.0).max(0)
        share = 1.0 / (stiffness * (len(self._levels) + 1))
        self._turn_compliance = np.divide(share, lever**2, out=np.zeros(count), where=lever > 0.0)[
            :, None
        ]
        """Rotation of each joint per torque [rad/(N m)]."""
        self._shift_compliance = np.where(self._roots, share, 0.0)[:, None]
        """Displacement of each root per force [m/N]."""
        self.compliance = share
        """Displacement of a root per force [m/N]."""
        self.turn = np.zeros((count, 3))
        """Deflection of each joint as a rotation vector [rad], shape [B, 3]."""
        self.shift = np.zeros((count, 3))
        """Deflection of each root [m], shape [B, 3]."""
        self._heads = rig.bone_rest[:, :3, 3].copy()
        self.change = np.tile(np.eye(4), (count, 1, 1))
        """World transform of each bone by the deflections last applied, shape [B, 4, 4]."""

    def applied(self, poses: Array, frames: Array) -> tuple[Array, Array]:
        """Apply the deflections to target poses.

        Args:
            poses: Matrix of each bone, bone to world, shape [B, 4, 4].
            frames: Their rotations from rest as quaternions, shape [B, 4].

        Returns:
            Poses and rotations after deflection, with the same shapes.
        """
        if not (self.turn.any() or self.shift.any()):
            self._heads = poses[:, :3, 3].copy()
            self.change = np.tile(np.eye(4), (len(poses), 1, 1))
            return poses, frames
        rotation = matrices_from_rotation_vectors(self.turn)
        change = np.zeros_like(poses)
        heads = poses[:, :3, 3]
        for bones in self._levels:
            parent = self.parent[bones]
            before = np.where((parent < 0)[:, None, None], np.eye(4), change[np.maximum(parent, 0)])
            head = np.einsum("bij,bj->bi", before[:, :3, :3], heads[bones]) + before[:, :3, 3]
            own = rotation[bones]
            change[bones, :3, :3] = own @ before[:, :3, :3]
            change[bones, :3, 3] = (
                np.einsum("bij,bj->bi", own, before[:, :3, 3] - head) + head + self.shift[bones]
            )
            change[bones, 3, 3] = 1.0
        self.change = change
        deflected = change @ poses
        self._heads = deflected[:, :3, 3]
        return deflected, product(quaternions_from_matrices(change[:, :3, :3]), frames)

    def _equilibrium(self, nodes: Array, load: Array) -> tuple[Array, Array]:
        """Rotations of joints and displacements of roots in equilibrium with a load on nodes."""
        force = self._carried.T @ load
        torque = self._carried.T @ np.cross(nodes, load) - np.cross(self._heads, force)
        return torque * self._turn_compliance, force * self._shift_compliance

    def follow(self, nodes: Array, load: Array, time_step: float) -> None:
        """Update the deflections under a load for one time step.

        Args:
            nodes: Positions of the nodes [m], shape [N, 3].
            load: Force on each node [N], shape [N, 3].
            time_step: Length of the time step [s].
        """
        part = held_part(time_step)
        turn, shift = self._equilibrium(nodes, load)
        self.turn += part * (turn - self.turn)
        self.shift += part * (shift - self.shift)
        if not load.any() and max(np.abs(self.turn).max(), np.abs(self.shift).max()) < NEGLIGIBLE:
            self.reset()

    def response(self, nodes: Array, load: Array) -> Array:
        """Displacement of the nodes in equilibrium with a small load [m], shape [N, 3]."""
        turn, shift = self._equilibrium(nodes, load)
        # Each joint rotates everything beyond it about its own position.
        about = self._carried @ turn
        offset = self._carried @ (shift - np.cross(turn, self._heads))
        return np.cross(about, nodes) + offset

    def snapshot(self) -> dict[str, NDArray]:
        """The deflections."""
        return {name: getattr(self, name).copy() for name in ("turn", "shift", "change")}

    def restore(self, state: dict[str, NDArray]) -> None:
        """Restore the state returned by `snapshot`."""
        for name in ("turn", "shift", "change"):
            setattr(self, name, state[name].copy())

    def reset(self) -> None:
        """Set all deflections to zero."""
        self.turn[:] = 0.0
        self.shift[:] = 0.0


def _levels(parent: NDArray[np.int32]) -> list[NDArray[np.int64]]:
    """Bones by their depth in the skeleton, roots first."""
    depth = np.zeros(len(parent), int)
    for bone, ancestor in enumerate(parent):
        if ancestor >= 0:
            depth[bone] = depth[ancestor] + 1
    return [np.flatnonzero(depth == level) for level in range(depth.max(initial=0) + 1)]
