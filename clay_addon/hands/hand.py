# SPDX-License-Identifier: GPL-3.0-or-later
"""Clay hands: rigged meshes that shape the clay, bound once and posed by their armature."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
from numpy.typing import NDArray

from ...solver.hand.rig import HandRig
from ..base.mesh_geometry import SWITCHED_OFF, is_switched_off
from ..base.preferences import missing_parts
from ..base.units import pose_to_meters, to_meters
from ..core.tracking.hand.bone_names import side_of_rig
from .changes import changed_part, source_digest
from .reading import HandError, armature_matrix, hand_armature, skinned_hand, weights_digest
from .store import (
    StoredHand,
    forget_hand,
    is_stored,
    load_hand,
    store_hand,
    stored_source,
    stored_spacing,
)


def hand_objects(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The clay hands of a scene, sorted by name."""
    found = [
        item for item in scene.objects if item.type == "MESH" and item.tactile_clay.role == "HAND"
    ]
    return sorted(found, key=lambda item: item.name)


def make_hand(
    context: bpy.types.Context,
    item: bpy.types.Object,
    *,
    side: str = "",
    clay_spacing: float | None = None,
) -> bpy.types.Object:
    """Bind a rigged mesh and make it a clay hand; an existing binding is replaced.

    Args:
        context: Context with the object's scene.
        item: A closed mesh object with an Armature modifier.
        side: "left" or "right"; by default derived from the names of the object and the bones.
        clay_spacing: Particle spacing of the clay [Blender units]; by default that of the scene's
            clay.

    Returns:
        The object.

    Raises:
        HandError: The object cannot be a hand; it is left unchanged.
    """
    keep_binding(item, binding_of(context, item, side=side, clay_spacing=clay_spacing))
    return item


def binding_of(
    context: bpy.types.Context,
    item: bpy.types.Object,
    *,
    side: str = "",
    clay_spacing: float | None = None,
) -> StoredHand:
    """Bind a rigged mesh as `make_hand` does, without changing it.

    Raises:
        HandError: The object cannot be a hand.
    """
    from ...solver.hand.binding import bind_hand

    for message in missing_parts():
        raise HandError(message)
    if item.library is not None or (item.data is not None and item.data.library is not None):
        raise HandError(
            f"{item.name!r} is linked from another file, so its binding would not be saved here. "
            "Make it local (Object > Relations > Make Local), or bind it in that file."
        )
    hand = skinned_hand(context, item)
    hand = replace(hand, side=side or side_of_rig(item.name, hand.bone_names))
    spacing = scene_spacing(context.scene) if clay_spacing is None else clay_spacing
    try:
        rig = bind_hand(hand, clay_spacing=to_meters(context.scene, spacing))
    except ValueError as error:
        raise HandError(f"{item.name!r}: {error}") from error
    armature = armature_matrix(hand_armature(item), context.evaluated_depsgraph_get())
    return StoredHand(rig, armature, weights_digest(hand), source_digest(item))


def keep_binding(item: bpy.types.Object, binding: StoredHand) -> None:
    """Make an object a clay hand that is bound so; an existing binding is replaced."""
    store_hand(item.data, binding)
    item.tactile_clay.role = "HAND"


def remove_hand(item: bpy.types.Object) -> None:
    """Turn a hand back into a plain object; its binding is deleted unless another hand uses it."""
    item.tactile_clay.role = "NONE"
    users = [
        other
        for other in bpy.data.objects
        if other.data == item.data and other.tactile_clay.role == "HAND"
    ]
    if not users:
        forget_hand(item.data)


def read_hand_rig(context: bpy.types.Context, item: bpy.types.Object) -> HandRig:
    """Read a bound hand [m].

    Raises:
        HandError: It is not bound, or has changed since; the message says how.
    """
    stored = _loaded(item)
    change = changed_part(context, item, stored)
    if change:
        raise HandError(
            f"{item.name!r} no longer matches its binding: {change}. Press Make Clay Hand again."
        )
    return stored.rig


def hand_bone_matrices(
    item: bpy.types.Object, depsgraph: bpy.types.Depsgraph
) -> dict[str, NDArray[np.float64]]:
    """Matrix of each bone at the current frame, bone to world [m], by bone name, shape [4, 4].

    Raises:
        HandError: The hand has no armature or is disabled, or a bone's matrix is not finite.
    """
    rig = hand_armature(item)
    for part in (item, rig):
        if is_switched_off(part, depsgraph):
            raise HandError(f"{part.name!r} {SWITCHED_OFF}")
    evaluated = rig.evaluated_get(depsgraph)
    world = np.array(evaluated.matrix_world, np.float64)
    matrices = {}
    for bone in evaluated.pose.bones:
        if bone.name not in item.vertex_groups:
            continue
        matrix = world @ np.array(bone.matrix, np.float64)
        if not np.isfinite(matrix).all():
            raise HandError(
                f"The matrix of bone {bone.name!r} of {rig.name!r} is not finite (NaN or infinite) "
                f"at frame {depsgraph.scene.frame_current}."
            )
        matrices[bone.name] = pose_to_meters(depsgraph.scene, matrix)
    return matrices


def hand_message(scene: bpy.types.Scene, item: bpy.types.Object) -> str:
    """Quickly check a clay hand, for panels; `read_hand_rig` checks thoroughly.

    Returns:
        The problem as a sentence; empty if there is none.
    """
    if not is_stored(item.data):
        return f"{item.name!r} is not a clay hand. Press Make Clay Hand."
    try:
        if source_digest(item) != stored_source(item.data):
            return f"{item.name!r} has changed since it was bound. Press Make Clay Hand again."
    except HandError as error:
        return str(error)
    bound = 2.0 * stored_spacing(item.data)
    if abs(bound - to_meters(scene, scene_spacing(scene))) > 0.01 * bound:
        return (
            f"{item.name!r} was bound for clay with another particle spacing. Press Make Clay Hand "
            "again, so that it fits this clay."
        )
    return ""


def scene_spacing(scene: bpy.types.Scene) -> float:
    """Particle spacing of the clay in a scene, or else of new clay [Blender units]."""
    spacings = [
        item.tactile_clay.spacing
        for item in scene.objects
        if item.type == "POINTCLOUD" and item.tactile_clay.role == "CLAY"
    ]
    return min((s for s in spacings if s > 0.0), default=scene.tactile_clay.spacing)


def _loaded(item: bpy.types.Object) -> StoredHand:
    if item.type != "MESH" or item.tactile_clay.role != "HAND" or not is_stored(item.data):
        raise HandError(f"{item.name!r} is not a clay hand. Press Make Clay Hand.")
    try:
        return load_hand(item.data)
    except ValueError as error:
        raise HandError(f"{item.name!r}: {error}. Press Make Clay Hand again.") from error
