# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads a rigged mesh for the solver: its rest pose in meters, its bones and their weights."""

from __future__ import annotations

import hashlib

import bmesh
import bpy
import numpy as np
from numpy.typing import NDArray

from ...solver.core.errors import TactileClayError
from ...solver.hand.skinned_hand import SkinnedHand
from ..base.mesh_geometry import SWITCHED_OFF, is_switched_off, oriented_triangles, transform
from ..base.units import pose_to_meters, to_meters

_WELD_DISTANCE = 1e-5
"""Vertices closer than this, relative to the hand's length, are welded: UV seams split them."""


class HandError(TactileClayError):
    """An object cannot be a clay hand; the message says why and what to do."""


def hand_armature(item: bpy.types.Object) -> bpy.types.Object:
    """The armature that deforms a mesh.

    Raises:
        HandError: The object is not a mesh, or has no armature or several.
    """
    if item.type != "MESH":
        kind = item.type.lower()
        raise HandError(f"{item.name!r} is not a mesh ({kind}). Select a hand's mesh.")
    rigs = {
        modifier.object
        for modifier in item.modifiers
        if modifier.type == "ARMATURE" and modifier.object is not None and modifier.show_viewport
    }
    if not rigs:
        raise HandError(
            f"{item.name!r} is not rigged: it has no enabled Armature modifier with an armature. "
            "Parent it to one (Ctrl+P, With Automatic Weights)."
        )
    if len(rigs) > 1:
        raise HandError(f"{item.name!r} has {len(rigs)} armatures; a hand can have only one.")
    (rig,) = rigs
    return rig


def skinned_hand(context: bpy.types.Context, item: bpy.types.Object) -> SkinnedHand:
    """Read a rigged mesh in its rest pose at its current location, in world coordinates [m].

    Modifiers other than the armature are applied, and vertices at the same position are welded,
    such as those along the seams of an imported mesh. The object is not changed.

    Raises:
        HandError: The object is not a rigged mesh, or Blender does not evaluate it.
    """
    rig = hand_armature(item)
    depsgraph = context.evaluated_depsgraph_get()
    if item.mode == "EDIT":
        raise HandError(f"{item.name!r} is being edited. Leave Edit Mode first (Tab).")
    for part in (item, rig):
        if is_switched_off(part, depsgraph):
            raise HandError(f"{part.name!r} {SWITCHED_OFF}")
    bones = [bone for bone in rig.data.bones if bone.use_deform]
    column = {bone.name: index for index, bone in enumerate(bones)}
    groups = {
        group.index: column[group.name] for group in item.vertex_groups if group.name in column
    }
    if not groups:
        raise HandError(
            f"{item.name!r} has no vertex group named after a bone of {rig.name!r}, so no bone "
            "moves it. Parent it again (Ctrl+P, With Automatic Weights)."
        )
    points, triangles, weights = _rest_mesh(context, item, groups, len(bones))
    matrix = np.array(item.evaluated_get(depsgraph).matrix_world, np.float64)
    world = armature_matrix(rig, depsgraph)
    used = np.flatnonzero(weights.any(0)) if len(weights) else np.zeros(0, np.int64)
    if not len(used):
        raise HandError(
            f"No vertex of {item.name!r} has a weight for a bone of {rig.name!r}. Parent it again "
            "(Ctrl+P, With Automatic Weights)."
        )
    kept = [bones[index] for index in used]
    names = [bone.name for bone in kept]
    rest = np.stack([pose_to_meters(context.scene, bone.matrix_local) for bone in kept])
    return SkinnedHand(
        vertices=to_meters(context.scene, transform(matrix, points)) if len(points) else points,
        faces=oriented_triangles(matrix, triangles),
        bone_names=tuple(names),
        bone_rest=world @ rest,
        bone_parent=np.array([_parent_index(bone, names) for bone in kept], np.int32),
        weights=weights[:, used],
    )


def _parent_index(bone: bpy.types.Bone, names: list[str]) -> int:
    """Index of the nearest ancestor in ``names``; -1 if there is none."""
    ancestor = bone.parent
    while ancestor is not None and ancestor.name not in names:
        ancestor = ancestor.parent
    return -1 if ancestor is None else names.index(ancestor.name)


def armature_matrix(rig: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> NDArray[np.float64]:
    """World matrix of an armature [m], shape [4, 4]."""
    return pose_to_meters(depsgraph.scene, rig.evaluated_get(depsgraph).matrix_world)


def _rest_mesh(
    context: bpy.types.Context, item: bpy.types.Object, groups: dict[int, int], bone_count: int
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64]]:
    """Welded vertices, triangles and weights in the rest pose, in the object's coordinates."""
    # A copy without Armature modifiers is in the rest pose, even if the armature is linked.
    copy = item.copy()
    try:
        for modifier in [m for m in copy.modifiers if m.type == "ARMATURE"]:
            copy.modifiers.remove(modifier)
        context.scene.collection.objects.link(copy)
        depsgraph = context.evaluated_depsgraph_get()
        evaluated = copy.evaluated_get(depsgraph)
        mesh = evaluated.to_mesh(preserve_all_data_layers=True, depsgraph=depsgraph)
        welded = bmesh.new()
        try:
            welded.from_mesh(mesh)
            return _arrays(welded, groups, bone_count)
        finally:
            welded.free()
            evaluated.to_mesh_clear()
    finally:
        bpy.data.objects.remove(copy)


def _arrays(
    mesh: bmesh.types.BMesh, groups: dict[int, int], bone_count: int
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64]]:
    points = np.array([vertex.co for vertex in mesh.verts], np.float64).reshape(-1, 3)
    if len(points) and np.isfinite(points).all():
        distance = _WELD_DISTANCE * float(np.ptp(points, axis=0).max())
        bmesh.ops.remove_doubles(mesh, verts=mesh.verts[:], dist=distance)
        points = np.array([vertex.co for vertex in mesh.verts], np.float64).reshape(-1, 3)
    mesh.verts.index_update()
    triangles = np.array(
        [[loop.vert.index for loop in corners] for corners in mesh.calc_loop_triangles()], np.int32
    ).reshape(-1, 3)
    weights = np.zeros((len(points), bone_count))
    layer = mesh.verts.layers.deform.active
    if layer is not None:
        for vertex in mesh.verts:
            for group, weight in vertex[layer].items():
                if group in groups:
                    weights[vertex.index, groups[group]] = weight
    return points, triangles, weights


def weights_digest(hand: SkinnedHand) -> str:
    """Hash of the weights, 32 hexadecimal digits."""
    rounded = np.ascontiguousarray(hand.weights, np.float32)
    return hashlib.blake2b(rounded.tobytes(), digest_size=16).hexdigest()
