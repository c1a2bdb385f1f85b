# SPDX-License-Identifier: GPL-3.0-or-later
"""Poses the bones of an armature, in Blender units, from a tracked hand, in meters."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ..base.units import pose_from_meters, pose_to_meters
from ..core.tracking import TrackingError
from ..core.tracking.hand.bone_names import joints_of_bones, side_of_rig
from ..core.tracking.hand.presence import TrackedHand
from ..core.tracking.hand.retarget import HandTarget, RetargetError

Array = NDArray[np.float64]

CONTACT_PROPERTY = "clay_contact"
"""Custom property of the armature object: how strongly the hand touches the clay, 0 to 1."""
_MIN_JOINTS = 6
"""An armature is a hand if at least this many of its bones are joints of a hand."""


def is_hand(item: bpy.types.Object) -> bool:
    """Whether an object is an armature whose bones are joints of a hand."""
    if item.type != "ARMATURE":
        return False
    return len(joints_of_bones(item.data.bones.keys())) >= _MIN_JOINTS


def side_of(armature: bpy.types.Object) -> str:
    """The side in an armature's name, or else in its bones' names; empty if ambiguous."""
    return side_of_rig(armature.name, armature.data.bones.keys())


def read_target(armature: bpy.types.Object, side: str, scene: bpy.types.Scene) -> HandTarget:
    """Read an armature's rig as the target for a tracked hand.

    Raises:
        TrackingError: It cannot follow a tracked hand; the message says why and what to do.
    """
    world = np.array(armature.matrix_world, np.float64)
    scales = np.linalg.norm(world[:3, :3], axis=0)
    if scales.min() < 1e-9 or scales.max() > 1.001 * scales.min():
        raise TrackingError(
            f"The scale of {armature.name!r} is zero or not uniform. Apply its scale (Ctrl-A)."
        )
    bones = {}
    for bone in armature.data.bones:
        matrix = world @ np.array(bone.matrix_local, np.float64)
        bones[bone.name] = pose_to_meters(scene, matrix)
    try:
        return HandTarget(bones, side)
    except RetargetError as error:
        raise TrackingError(f"{armature.name!r} cannot follow a hand: {error}") from error


def placed(
    target: HandTarget, hand: TrackedHand, origin: bpy.types.Object | None, scene: bpy.types.Scene
) -> dict[str, Array]:
    """World matrices of a rig's bones for a hand [Blender units], by bone name, shape [4, 4].

    Args:
        target: The rig.
        hand: The hand.
        origin: Object at the tracker's position and rotation (its scale is ignored); if None, the
            tracker is at the world origin.
        scene: Provides the unit scale.
    """
    space = np.eye(4)
    if origin is not None:
        space = np.array(Matrix.LocRotScale(*origin.matrix_world.decompose()[:2], None), np.float64)
    matrices = target.posed(hand.positions, hand.quaternions, hand.valid)
    return {name: space @ pose_from_meters(scene, matrix) for name, matrix in matrices.items()}


def local_poses(armature: bpy.types.Object, matrices: dict[str, Array]) -> dict[str, Matrix]:
    """The ``matrix_basis`` of each bone that gives the bones these world matrices.

    Bones that are not named, such as parents or bones in between, keep their transforms.

    Args:
        armature: The armature object.
        matrices: World matrices by bone name [Blender units], shape [4, 4].
    """
    inverse = armature.matrix_world.inverted_safe()
    targets = {name: inverse @ Matrix(matrix) for name, matrix in matrices.items()}
    poses: dict[str, Matrix] = {}
    results: dict[str, Matrix] = {}

    def pose(bone: bpy.types.Bone) -> Matrix:
        if bone.name in poses:
            return poses[bone.name]
        parent = {}
        if bone.parent is not None:
            parent = {
                "parent_matrix": pose(bone.parent),
                "parent_matrix_local": bone.parent.matrix_local,
            }
        if bone.name in targets:
            basis = bone.convert_local_to_pose(
                targets[bone.name], bone.matrix_local, **parent, invert=True
            )
            results[bone.name] = basis
        else:
            basis = armature.pose.bones[bone.name].matrix_basis
        poses[bone.name] = bone.convert_local_to_pose(basis, bone.matrix_local, **parent)
        return poses[bone.name]

    for name in targets:
        if name in armature.data.bones:
            pose(armature.data.bones[name])
    return results


def write_pose(armature: bpy.types.Object, matrices: dict[str, Array], contact: float) -> None:
    """Pose an armature and store how strongly the hand touches the clay.

    Args:
        armature: The armature object.
        matrices: World matrices by bone name [Blender units], shape [4, 4].
        contact: How strongly the hand touches the clay, 0 to 1.
    """
    for name, basis in local_poses(armature, matrices).items():
        armature.pose.bones[name].matrix_basis = basis
    armature[CONTACT_PROPERTY] = float(contact)
    armature.update_tag()
