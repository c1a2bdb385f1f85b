# SPDX-License-Identifier: GPL-3.0-or-later
"""Clay hands: rigged meshes that work the clay, bound once and posed by their armature."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
from numpy.typing import NDArray

from ...solver.hand.rig import HandRig
from ...solver.hand.skinned_hand import SkinnedHand
from ..base.mesh_geometry import SWITCHED_OFF, is_switched_off
from ..base.preferences import missing_parts
from ..base.units import pose_to_meters, to_meters
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
    """The clay hands of a scene, by name."""
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
    """Bind a rigged mesh, so that it works the clay; binding again replaces what was bound.

    Args:
        context: Where the object is.
        item: A closed mesh object with an Armature modifier.
        side: "left" or "right"; told by the names of object and bones where not given.
        clay_spacing: Distance of the clay's particles [Blender units]; that of the scene's clay
            where not given.

    Raises:
        HandError: The object cannot be a hand; it stays as it was.
    """
    from ...solver.hand.binding import bind_hand

    for sentence in missing_parts():
        raise HandError(sentence)
    if item.library is not None or (item.data is not None and item.data.library is not None):
        raise HandError(
            f"{item.name!r} is linked from another file, so this one would not keep what is bound. "
            "Make it local (Object > Relations > Make Local), or bind it there."
        )
    hand = skinned_hand(context, item)
    hand = replace(hand, side=side or _side_of(item, hand))
    spacing = scene_spacing(context.scene) if clay_spacing is None else clay_spacing
    try:
        rig = bind_hand(hand, clay_spacing=to_meters(context.scene, spacing))
    except ValueError as error:
        raise HandError(f"{item.name!r}: {error}") from error
    armature = armature_matrix(hand_armature(item), context.evaluated_depsgraph_get())
    stored = StoredHand(rig, armature, weights_digest(hand), source_digest(item))
    store_hand(item.data, stored)
    item.tactile_clay.role = "HAND"
    return item


def remove_hand(item: bpy.types.Object) -> None:
    """Let an object no longer work the clay, and drop what was bound unless others use it."""
    item.tactile_clay.role = "NONE"
    users = [
        other
        for other in bpy.data.objects
        if other.data == item.data and other.tactile_clay.role == "HAND"
    ]
    if not users:
        forget_hand(item.data)


def read_hand_rig(context: bpy.types.Context, item: bpy.types.Object) -> HandRig:
    """The hand as it was bound [m].

    Raises:
        HandError: It is not bound, or something changed since; the message says what.
    """
    stored = _loaded(item)
    change = changed_part(context, item, stored)
    if change:
        raise HandError(
            f"{item.name!r} is not the hand that was bound: {change}. Press Make Clay Hand again."
        )
    return stored.rig


def hand_bone_matrices(
    item: bpy.types.Object, depsgraph: bpy.types.Depsgraph
) -> dict[str, NDArray[np.float64]]:
    """World from each bone's own coordinates at the current frame [m], by name, shape [4, 4].

    Raises:
        HandError: The hand has lost its armature, or a bone's place is not finite.
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
                f"The bone {bone.name!r} of {rig.name!r} is not finite (NaN or infinite) at frame "
                f"{depsgraph.scene.frame_current}."
            )
        matrices[bone.name] = pose_to_meters(depsgraph.scene, matrix)
    return matrices


def hand_message(scene: bpy.types.Scene, item: bpy.types.Object) -> str:
    """What is wrong with a clay hand at a glance, as a sentence; empty where nothing seems to be.

    `read_hand_rig` looks closer.
    """
    if not is_stored(item.data):
        return f"{item.name!r} is no clay hand. Press Make Clay Hand."
    try:
        if source_digest(item) != stored_source(item.data):
            return f"{item.name!r} has changed since it was bound. Press Make Clay Hand again."
    except HandError as error:
        return str(error)
    bound_for, wanted = 2.0 * stored_spacing(item.data), scene_spacing(scene)
    if abs(bound_for - to_meters(scene, wanted)) > 0.01 * bound_for:
        return (
            f"{item.name!r} was bound for clay of another spacing. Press Make Clay Hand again, so "
            "that it fits this clay."
        )
    return ""


def scene_spacing(scene: bpy.types.Scene) -> float:
    """Distance of particles of the clay in a scene, or else of new clay [Blender units]."""
    spacings = [
        item.tactile_clay.spacing
        for item in scene.objects
        if item.type == "POINTCLOUD" and item.tactile_clay.role == "CLAY"
    ]
    return min((s for s in spacings if s > 0.0), default=scene.tactile_clay.spacing)


def _loaded(item: bpy.types.Object) -> StoredHand:
    if item.type != "MESH" or item.tactile_clay.role != "HAND" or not is_stored(item.data):
        raise HandError(f"{item.name!r} is no clay hand. Press Make Clay Hand.")
    try:
        return load_hand(item.data)
    except ValueError as error:
        raise HandError(f"{item.name!r}: {error}. Press Make Clay Hand again.") from error


def _side_of(item: bpy.types.Object, hand: SkinnedHand) -> str:
    """Tell the side by names such as l_hand, Hand.R or LeftHandIndex1."""
    words = [item.name, *hand.bone_names]
    for side, letter in (("left", "l"), ("right", "r")):
        for word in words:
            lowered = word.lower()
            if (
                side in lowered
                or lowered.startswith(f"{letter}_")
                or lowered.endswith((f".{letter}", f"_{letter}"))
            ):
                return side
    return ""
