# SPDX-License-Identifier: GPL-3.0-or-later
"""Lays a tracked hand on the bones of a rig, whose lengths stay what they are.

Each joint's orientation is taken as it is, absolute; positions follow from the rig's own bones. A
tracker whose bones breathe, or a person whose hand is of another size, moves the rig without
stretching it. Where the sizes differ, the palms lie on each other.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .....solver.core.errors import TactileClayError
from .....solver.geometry.rotations import fitted_rotation, matrices_from_quaternions, shortest_turn
from ..protocol.joints import (
    FINGERS,
    FROM_ROOT,
    JOINT_COUNT,
    KNUCKLES,
    PALM_JOINTS,
    PARENTS,
    WRIST,
    reference_hand,
)
from .bone_names import joints_of_bones

Array = NDArray[np.float64]

Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Turns the trackers' Y-up space to Blender's Z-up one."""
_MIN_AGREEMENT, _MIN_UPRIGHT = 0.8, 0.5
"""A rig's axes are OpenXR's from these cosines on: of its bones with their -Z, and of its wrist's Y
with the back of the hand."""


class RetargetError(TactileClayError, ValueError):
    """A rig cannot take a tracked hand; the message says why and what to do."""


class HandTarget:
    """A rig that tracked hands can be laid on.

    Bones may be parentless or not, named as in OpenXR, WebXR or the usual animation rigs, and have
    any axes: where those are not OpenXR's, they are seen to from how the bones lie at rest.

    Example:
        target = HandTarget({"wrist": np.eye(4), ...}, "right")
        matrices = target.posed(hand.positions, hand.quaternions, hand.valid)

    Limitations: bones that are no joint of the hand are left alone. Scale in the rest matrices is
    kept; shear is not foreseen.
    """

    def __init__(self, bones: Mapping[str, ArrayLike], side: str) -> None:
        """Look at a rig.

        Args:
            bones: World from each bone's own coordinates at rest [m], shape [4, 4], Z up.
            side: Left or right.

        Raises:
            RetargetError: It has no wrist, no finger, or two bones on one spot.
        """
        self.side = side
        self.joints = joints_of_bones(bones)
        """Number of the joint that each bone is, for bones that are one."""
        self._rest = {name: np.asarray(bones[name], np.float64) for name in self.joints}
        bone_of = {joint: name for name, joint in self.joints.items()}
        if WRIST not in bone_of:
            raise RetargetError(
                "The rig has no bone for the wrist. Name one 'wrist' or 'hand'; its bones are "
                f"{_listed(bones)}."
            )
        whole = [name for finger in FINGERS for name in finger if name in bone_of]
        if len(whole) < 2:
            raise RetargetError(
                "The rig has no finger bones with names that are known, such as 'index_proximal' "
                f"or 'index-finger-phalanx-proximal'; its bones are {_listed(bones)}."
            )
        for name, matrix in self._rest.items():
            if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:3, :3])) < 1e-12:
                raise RetargetError(f"The bone {name!r} has no size or is not finite.")
        self._heads = {joint: self._rest[name][:3, 3] for joint, name in bone_of.items()}
        self._parents = {joint: self._carrier(joint) for joint in self._heads}
        axes = self._joint_axes()
        self._offsets = {
            joint: axes[parent].T @ (self._heads[joint] - self._heads[parent])
            for joint, parent in self._parents.items()
            if parent >= 0
        }
        self._axes = axes

    def posed(
        self, positions: ArrayLike, quaternions: ArrayLike, valid: ArrayLike | None = None
    ) -> dict[str, Array]:
        """Where the bones are for a tracked hand.

        Args:
            positions: Position of each joint [m], Y up, shape [26, 3].
            quaternions: Orientation of each joint (x, y, z, w), shape [26, 4].
            valid: Which joints may be used, all by default; the others follow what carries them,
                as at rest; shape [26].

        Returns:
            World from each bone's own coordinates [m], Z up, shape [4, 4], for each bone that is
            a joint.
        """
        points = np.asarray(positions, np.float64) @ Z_UP.T
        turns = Z_UP @ matrices_from_quaternions(quaternions)
        usable = np.ones(JOINT_COUNT, bool) if valid is None else np.asarray(valid, bool)
        rotations: dict[int, Array] = {}
        heads: dict[int, Array] = {}
        for joint in FROM_ROOT:
            if joint not in self._heads:
                continue
            parent = self._parents[joint]
            if usable[joint] or parent < 0:
                rotations[joint] = turns[joint]
            else:
                rotations[joint] = rotations[parent] @ self._axes[parent].T @ self._axes[joint]
            heads[joint] = (
                np.zeros(3)
                if parent < 0
                else heads[parent] + rotations[parent] @ self._offsets[joint]
            )
        anchors = [joint for joint in PALM_JOINTS if joint in heads and usable[joint]] or [WRIST]
        shift = np.mean([points[joint] - heads[joint] for joint in anchors], axis=0)
        result = {}
        for name, joint in self.joints.items():
            matrix = np.eye(4)
            matrix[:3, :3] = rotations[joint] @ self._axes[joint].T @ self._rest[name][:3, :3]
            matrix[:3, 3] = heads[joint] + shift
            result[name] = matrix
        return result

    def _carrier(self, joint: int) -> int:
        """The nearest joint towards the wrist that has a bone; -1 for the wrist."""
        parent = PARENTS[joint]
        while parent >= 0 and parent not in self._heads:
            parent = PARENTS[parent]
        return parent

    def _joint_axes(self) -> dict[int, Array]:
        """OpenXR's axes of each joint as the rig is at rest, as columns, shape [3, 3]."""
        axes = {}
        for name, joint in self.joints.items():
            linear = self._rest[name][:3, :3]
            axes[joint] = linear / np.linalg.norm(linear, axis=0)
        return axes if self._are_openxr(axes) else self._derived_axes()

    def _are_openxr(self, axes: Mapping[int, Array]) -> bool:
        """Whether -Z runs along the finger bones, and Y out of the back of the hand."""
        cosines = []
        for finger in FINGERS:
            for joint, following in pairwise(finger):
                if joint in self._heads and following in self._heads:
                    bone = self._heads[following] - self._heads[joint]
                    length = max(float(np.linalg.norm(bone)), 1e-9)
                    cosines.append(float(-axes[joint][:, 2] @ bone) / length)
        palm = self._palm_axes()
        upright = palm is None or float(axes[WRIST][:, 1] @ palm[:, 1]) > _MIN_UPRIGHT
        return upright and bool(cosines) and float(np.mean(cosines)) >= _MIN_AGREEMENT

    def _palm_axes(self) -> Array | None:
        """Axes of the palm from how the knuckles lie about the wrist; None without knuckles."""
        anchors = [joint for joint in (WRIST, *KNUCKLES, FINGERS[0][0]) if joint in self._heads]
        if sum(joint in self._heads for joint in KNUCKLES) < 2:
            return None
        rest = reference_hand(self.side).positions[anchors]
        return fitted_rotation(rest, np.array([self._heads[joint] for joint in anchors]))

    def _derived_axes(self) -> dict[int, Array]:
        palm = self._palm_axes()
        if palm is None:
            raise RetargetError(
                "The rig's bones have axes of their own and it has less than two knuckles, so that "
                "its palm cannot be told. Give it bones for the fingers' proximal joints."
            )
        axes = {WRIST: palm}
        reference = reference_hand(self.side).rotations
        for joint in FROM_ROOT:
            if joint not in self._heads or joint == WRIST:
                continue
            parent = self._parents[joint]
            guess = axes[parent] @ reference[parent].T @ reference[joint]
            following = self._following(joint)
            if following is not None:
                bone = self._heads[following] - self._heads[joint]
                length = float(np.linalg.norm(bone))
                if length < 1e-6:
                    raise RetargetError("Two finger joints of the rig lie on one spot.")
                guess = shortest_turn(-guess[:, 2], bone / length) @ guess
            axes[joint] = guess
        return axes

    def _following(self, joint: int) -> int | None:
        for finger in FINGERS:
            if joint in finger:
                later = [each for each in finger[finger.index(joint) + 1 :] if each in self._heads]
                return later[0] if later else None
        return None


def _listed(bones: Mapping[str, ArrayLike]) -> str:
    names = list(bones)
    return ", ".join(names[:12]) + (", …" if len(names) > 12 else "") if names else "none"
