# SPDX-License-Identifier: GPL-3.0-or-later
"""Between tracked hands in meters and the bones of an armature object in Blender units."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ..base.units import pose_from_meters, pose_to_meters
from ..core.tracking import TrackingError
from ..core.tracking.hand.bone_names import joints_of_bones, side_of_bones
from ..core.tracking.hand.presence import TrackedHand
from ..core.tracking.hand.retarget import HandTarget, RetargetError

Array = NDArray[np.float64]

CONTACT_PROPERTY = "clay_contact"
"""Custom property of the armature object: how much of the hand touches the clay, 0 to 1."""


def is_hand(armature: bpy.types.Object) -> bool:
    """Whether an armature has bones that are joints of a hand."""
    return armature.type == "ARMATURE" and len(joints_of_bones(armature.data.bones.keys())) > 5


def side_of(armature: bpy.types.Object) -> str:
    """The side that an armature's name, or its bones' names, say; empty where neither does."""
    return side_of_bones([armature.name]) or side_of_bones(armature.data.bones.keys())


def read_target(armature: bpy.types.Object, side: str, scene: bpy.types.Scene) -> HandTarget:
    """The rig of an armature, for hands to be laid on.

    Raises:
        TrackingError: It cannot take a tracked hand; the message says why and what to do.
    """
    world = np.array(armature.matrix_world, np.float64)
    scales = np.linalg.norm(world[:3, :3], axis=0)
    if scales.min() < 1e-9 or scales.max() > 1.001 * scales.min():
        raise TrackingError(
            f"{armature.name!r} is scaled unevenly or to nothing: apply its scale (Ctrl-A)."
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
    """Where a hand puts a rig's bones, in world space and Blender units, shape [4, 4] each.

    Args:
        target: The rig.
        hand: The hand.
        origin: The object that stands where the tracker does; the world's origin without one. Its
            scale says nothing.
        scene: Its unit scale tells how long a Blender unit is.
    """
    space = np.eye(4)
    if origin is not None:
        space = np.array(Matrix.LocRotScale(*origin.matrix_world.decompose()[:2], None), np.float64)
    matrices = target.posed(hand.positions, hand.quaternions, hand.valid)
    return {name: space @ pose_from_meters(scene, matrix) for name, matrix in matrices.items()}


def local_poses(armature: bpy.types.Object, matrices: dict[str, Array]) -> dict[str, Matrix]:
    """What each bone's own transform must be for the bones to be somewhere in world space.

    Bones between those named keep their transform; so do the bones that carry them.
    """
    inverse = armature.matrix_world.inverted_safe()
    wanted = {name: inverse @ Matrix(matrix) for name, matrix in matrices.items()}
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
        if bone.name in wanted:
            basis = bone.convert_local_to_pose(
                wanted[bone.name], bone.matrix_local, **parent, invert=True
            )
            results[bone.name] = basis
        else:
            basis = armature.pose.bones[bone.name].matrix_basis
        poses[bone.name] = bone.convert_local_to_pose(basis, bone.matrix_local, **parent)
        return poses[bone.name]

    for name in wanted:
        if name in armature.data.bones:
            pose(armature.data.bones[name])
    return results


def write_pose(armature: bpy.types.Object, matrices: dict[str, Array], contact: float) -> None:
    """Pose an armature in world space [Blender units], and say how much of it touches the clay."""
    for name, basis in local_poses(armature, matrices).items():
        armature.pose.bones[name].matrix_basis = basis
    armature[CONTACT_PROPERTY] = float(contact)
    armature.update_tag()
