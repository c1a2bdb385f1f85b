# SPDX-License-Identifier: GPL-3.0-or-later
"""The default hand in Blender: an armature with OpenXR's 26 joints that deforms a generated skin.

A bone's -Z points along the finger and its +Y out of the back of the hand, as in OpenXR. Blender
draws bones along +Y, so they get a custom shape that points along -Z. Rotating a bone about its X
axis bends the finger.
"""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix

from ...solver.core.errors import TactileClayError
from ...solver.hand.default_hand import default_hand
from ...solver.hand.proportions import AVERAGE, REFERENCE_LENGTH, HandProportions
from ...solver.hand.skinned_hand import SkinnedHand
from ..base.preferences import missing_parts
from ..base.units import meters_per_unit
from .hand import make_hand
from .look import add_hand_look

_BONE_SHAPE = "Clay hand bone"
_BONE_LENGTH = 0.008
"""Length of each bone along its +Y in Blender, which has no meaning for the hand [m]."""


class AddHandError(TactileClayError):
    """The default hand cannot be added; the message says why."""


def add_hand(
    context: bpy.types.Context,
    side: str = "right",
    *,
    length: float = REFERENCE_LENGTH,
    proportions: HandProportions = AVERAGE,
    matrix: Matrix | None = None,
) -> bpy.types.Object:
    """Add the default hand and bind it for the scene's clay.

    Args:
        context: The hand is added to its collection; it must be in Object Mode.
        side: "right" or "left".
        length: From the wrist joint to the tip of the straight middle finger [m].
        proportions: Sizes of the hand's parts relative to each other.
        matrix: World matrix of the hand, whose origin is the wrist [Blender units].

    Returns:
        The mesh object; its parent is the armature.

    Raises:
        AddHandError: A library that the solver needs is missing, or the side or length is invalid.
        HandError: The hand cannot be bound.
    """
    for message in missing_parts():
        raise AddHandError(message)
    try:
        hand = default_hand(side, length=length, proportions=proportions)
    except ValueError as error:
        raise AddHandError(str(error)) from error
    scale = meters_per_unit(context.scene)
    name = f"{side.capitalize()} hand"
    armature = _add_armature(context, hand, name, scale)
    if matrix is not None:
        armature.matrix_world = matrix
    item = _add_skin(context, hand, name, scale)
    item.parent = armature
    modifier = item.modifiers.new("Armature", "ARMATURE")
    modifier.object = armature
    context.view_layer.update()
    try:
        make_hand(context, item, side=side)
    except Exception:
        for data in (item.data, armature.data):
            getattr(bpy.data, "meshes" if data == item.data else "armatures").remove(data)
        raise
    for other in context.selected_objects:
        other.select_set(False)
    armature.select_set(True)
    context.view_layer.objects.active = armature
    return item


def _add_armature(
    context: bpy.types.Context, hand: SkinnedHand, name: str, scale: float
) -> bpy.types.Object:
    data = bpy.data.armatures.new(f"{name} armature")
    armature = bpy.data.objects.new(f"{name} armature", data)
    context.collection.objects.link(armature)
    context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        bones: list[bpy.types.EditBone] = []
        for bone_name, rest, parent in zip(
            hand.bone_names, hand.bone_rest, hand.bone_parent, strict=True
        ):
            bone = data.edit_bones.new(bone_name)
            bone.head, bone.tail = (0.0, 0.0, 0.0), (0.0, _BONE_LENGTH / scale, 0.0)
            matrix = rest.copy()
            matrix[:3, 3] /= scale
            bone.matrix = Matrix(matrix.tolist())
            bone.parent = bones[parent] if parent >= 0 else None
            bones.append(bone)
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")
    armature.show_in_front = True
    shape = _bone_shape()
    for bone_name, length in _bone_lengths(hand).items():
        bone = armature.pose.bones[bone_name]
        bone.custom_shape = shape
        bone.use_custom_shape_bone_size = False
        bone.custom_shape_scale_xyz = (length / scale,) * 3
    return armature


def _bone_lengths(hand: SkinnedHand) -> dict[str, float]:
    """Distance from each bone to the next one of its finger, by bone name [m]."""
    lengths = dict.fromkeys(hand.bone_names, _BONE_LENGTH)
    heads = hand.bone_rest[:, :3, 3]
    for bone, parent in enumerate(hand.bone_parent):
        if parent > 0:
            lengths[hand.bone_names[parent]] = float(np.linalg.norm(heads[bone] - heads[parent]))
    return lengths


def _bone_shape() -> bpy.types.Object:
    """The bones' custom shape: an octahedron of unit length along -Z, not linked to any scene."""
    shape = bpy.data.objects.get(_BONE_SHAPE)
    if shape is not None:
        return shape
    ring = [(0.1, 0.0, -0.12), (0.0, 0.1, -0.12), (-0.1, 0.0, -0.12), (0.0, -0.1, -0.12)]
    faces = [(0, 1 + (n + 1) % 4, 1 + n) for n in range(4)]
    faces += [(5, 1 + n, 1 + (n + 1) % 4) for n in range(4)]
    mesh = bpy.data.meshes.new(_BONE_SHAPE)
    mesh.from_pydata([(0.0, 0.0, 0.0), *ring, (0.0, 0.0, -1.0)], [], faces)
    return bpy.data.objects.new(_BONE_SHAPE, mesh)


def _add_skin(
    context: bpy.types.Context, hand: SkinnedHand, name: str, scale: float
) -> bpy.types.Object:
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata((hand.vertices / scale).tolist(), [], hand.faces.tolist())
    mesh.shade_smooth()
    add_hand_look(mesh, hand)
    item = bpy.data.objects.new(name, mesh)
    context.collection.objects.link(item)
    for bone, bone_name in enumerate(hand.bone_names):
        group = item.vertex_groups.new(name=bone_name)
        for vertex in np.flatnonzero(hand.weights[:, bone]):
            group.add([int(vertex)], float(hand.weights[vertex, bone]), "REPLACE")
    return item
