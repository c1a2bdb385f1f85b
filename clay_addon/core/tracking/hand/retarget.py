# SPDX-License-Identifier: GPL-3.0-or-later
"""Retargets a tracked hand to the bones of a rig, keeping the rig's bone lengths.

Joint orientations are copied in world space; positions follow from the rig's own bones. Trackers
whose bone lengths fluctuate, and hands of another size, thus move the rig without stretching it.
Where the sizes differ, the palms are aligned.
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
"""Rotates the trackers' Y-up space into Blender's Z-up space."""
_MIN_BONE_COSINE, _MIN_BACK_COSINE = 0.8, 0.5
"""A rig is taken to have OpenXR's axes above these cosines: between its bones and their -Z, and
between its wrist's Y and the normal of the back of the hand."""


class RetargetError(TactileClayError, ValueError):
    """A rig cannot follow a tracked hand; the message says why and what to do."""


class HandTarget:
    """A rig that tracked hands are retargeted to.

    Bones may have parents or not, be named as in OpenXR, WebXR or common animation rigs, and have
    any axes: if these are not OpenXR's, the joints' axes are derived from the rest pose.

    Example:
        target = HandTarget({"wrist": np.eye(4), ...}, "right")
        matrices = target.posed(hand.positions, hand.quaternions, hand.valid)

    Limitations: bones that are not joints of a hand are not posed. Scale in the rest matrices is
    kept; shear is not supported.
    """

    def __init__(self, bones: Mapping[str, ArrayLike], side: str) -> None:
        """Analyze a rig.

        Args:
            bones: Rest matrix of each bone by name, bone to world [m], shape [4, 4], Z up.
            side: Left or right.

        Raises:
            RetargetError: It has no wrist, no fingers, or two joints at the same position.
        """
        self.side = side
        self.joints = joints_of_bones(bones)
        """Joint index of each bone that is a joint of the hand."""
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
                "The rig has no finger bones with familiar names, such as 'index_proximal' or "
                f"'index-finger-phalanx-proximal'; its bones are {_listed(bones)}."
            )
        for name, matrix in self._rest.items():
            if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:3, :3])) < 1e-12:
                raise RetargetError(
                    f"The rest matrix of bone {name!r} is not finite, or its scale is zero."
                )
        self._heads = {joint: self._rest[name][:3, 3] for joint, name in bone_of.items()}
        self._parents = {joint: self._parent_joint(joint) for joint in self._heads}
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
        """Pose the bones like a tracked hand.

        Args:
            positions: Position of each joint [m], Y up, shape [26, 3].
            quaternions: Orientation of each joint (x, y, z, w), shape [26, 4].
            valid: Which joints may be used, shape [26]; all by default. The others follow their
                parents rigidly.

        Returns:
            Matrix of each bone that is a joint, by name, bone to world [m], Z up, shape [4, 4].
        """
        points = np.asarray(positions, np.float64) @ Z_UP.T
        tracked = Z_UP @ matrices_from_quaternions(quaternions)
        usable = np.ones(JOINT_COUNT, bool) if valid is None else np.asarray(valid, bool)
        rotations: dict[int, Array] = {}
        heads: dict[int, Array] = {}
        for joint in FROM_ROOT:
            if joint not in self._heads:
                continue
            parent = self._parents[joint]
            if usable[joint] or parent < 0:
                rotations[joint] = tracked[joint]
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

    def _parent_joint(self, joint: int) -> int:
        """The nearest joint towards the wrist that has a bone; -1 for the wrist."""
        parent = PARENTS[joint]
        while parent >= 0 and parent not in self._heads:
            parent = PARENTS[parent]
        return parent

    def _joint_axes(self) -> dict[int, Array]:
        """OpenXR's axes of each joint in the rest pose, as columns, shape [3, 3]."""
        axes = {}
        for name, joint in self.joints.items():
            linear = self._rest[name][:3, :3]
            axes[joint] = linear / np.linalg.norm(linear, axis=0)
        return axes if self._are_openxr(axes) else self._derived_axes()

    def _are_openxr(self, axes: Mapping[int, Array]) -> bool:
        """Whether -Z points along the finger bones and Y out of the back of the hand."""
        cosines = []
        for finger in FINGERS:
            for joint, following in pairwise(finger):
                if joint in self._heads and following in self._heads:
                    bone = self._heads[following] - self._heads[joint]
                    length = max(float(np.linalg.norm(bone)), 1e-9)
                    cosines.append(float(-axes[joint][:, 2] @ bone) / length)
        palm = self._palm_axes()
        upright = palm is None or float(axes[WRIST][:, 1] @ palm[:, 1]) > _MIN_BACK_COSINE
        return upright and bool(cosines) and float(np.mean(cosines)) >= _MIN_BONE_COSINE

    def _palm_axes(self) -> Array | None:
        """Axes of the palm, from wrist and knuckles; None with fewer than two knuckles."""
        anchors = [joint for joint in (WRIST, *KNUCKLES, FINGERS[0][0]) if joint in self._heads]
        if sum(joint in self._heads for joint in KNUCKLES) < 2:
            return None
        rest = reference_hand(self.side).positions[anchors]
        return fitted_rotation(rest, np.array([self._heads[joint] for joint in anchors]))

    def _derived_axes(self) -> dict[int, Array]:
        palm = self._palm_axes()
        if palm is None:
            raise RetargetError(
                "The rig's bones do not have OpenXR's axes, and without two knuckles the "
                "orientation of its palm is unknown. Add bones for the fingers' proximal joints."
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
                    raise RetargetError("Two finger joints of the rig are at the same position.")
                guess = shortest_turn(-guess[:, 2], bone / length) @ guess
            axes[joint] = guess
        return axes

    def _following(self, joint: int) -> int | None:
        """The next joint towards the fingertip that has a bone."""
        for finger in FINGERS:
            if joint in finger:
                later = [each for each in finger[finger.index(joint) + 1 :] if each in self._heads]
                return later[0] if later else None
        return None


def _listed(bones: Mapping[str, ArrayLike]) -> str:
    names = list(bones)
    return ", ".join(names[:12]) + (", …" if len(names) > 12 else "") if names else "none"
