# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a hand is still the one that was bound, and what about it is not."""

from __future__ import annotations

import hashlib

import bpy
import numpy as np

from ...solver.geometry.rotations import rotation_and_stretch
from .reading import armature_matrix, hand_armature, skinned_hand, weights_digest
from .store import StoredHand

_UNCHANGED = 1e-4
"""A hand whose vertices moved by less than this share of its length is the one that was bound."""


def changed_part(context: bpy.types.Context, item: bpy.types.Object, stored: StoredHand) -> str:
    """What differs from the time of binding, in words; empty where nothing does."""
    now = skinned_hand(context, item)
    world = armature_matrix(hand_armature(item), context.evaluated_depsgraph_get())
    rig = stored.rig
    order = {name: index for index, name in enumerate(now.bone_names)}
    if set(order) != set(rig.bone_names):
        return "its bones have changed"
    least = _UNCHANGED * float(np.ptp(rig.vertices, axis=0).max())
    _, stretch = rotation_and_stretch(world[:3, :3])
    _, before = rotation_and_stretch(stored.armature[:3, :3])
    if not np.allclose(stretch, before, rtol=0.0, atol=_UNCHANGED * np.abs(before).max()):
        return "its size has changed"
    # Where the armature stands does not matter, only what it carries.
    back = stored.armature @ np.linalg.inv(world)
    rest = back @ now.bone_rest[[order[name] for name in rig.bone_names]]
    if np.abs(rest[:, :3, 3] - rig.bone_rest[:, :3, 3]).max() > least or not np.allclose(
        rest[:, :3, :3], rig.bone_rest[:, :3, :3], rtol=0.0, atol=1e-3
    ):
        return "its armature's rest pose has changed"
    if now.vertices.shape != rig.vertices.shape or not np.array_equal(now.faces, rig.faces):
        return "its mesh has changed"
    moved = now.vertices @ back[:3, :3].T + back[:3, 3]
    if np.abs(moved - rig.vertices).max() > least:
        return "its mesh has changed, or was moved against its armature"
    if weights_digest(now) != stored.weights_digest:
        return "its vertex weights have changed"
    return ""


def source_digest(item: bpy.types.Object) -> str:
    """Thirty-two hexadecimal digits of what is in the file of a hand, whatever its pose and place.

    Cheap, and free of side effects, so that a panel may ask. Neither vertex weights nor settings of
    modifiers are in it, which take longer.

    Raises:
        HandError: The object is not rigged.
    """
    rig = hand_armature(item)
    mesh = item.data
    digest = hashlib.blake2b(digest_size=16)
    places = np.empty((len(mesh.vertices), 3), np.float32)
    if len(places):
        mesh.attributes["position"].data.foreach_get("vector", places.ravel())
    corners = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    names = [group.name for group in item.vertex_groups]
    bones = [(bone.name, bone.use_deform, *np.ravel(bone.matrix_local)) for bone in rig.data.bones]
    modifiers = [(m.type, m.show_viewport) for m in item.modifiers]
    _, stretch = rotation_and_stretch(np.array(rig.matrix_world, np.float64)[:3, :3])
    digest.update(places.tobytes())
    digest.update(corners.tobytes())
    digest.update(repr((names, bones, modifiers, (np.round(stretch, 4) + 0.0).tolist())).encode())
    return digest.hexdigest()
