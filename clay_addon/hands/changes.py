# SPDX-License-Identifier: GPL-3.0-or-later
"""Detects how a hand has changed since it was bound."""

from __future__ import annotations

import hashlib

import bpy
import numpy as np

from ...solver.geometry.rotations import rotation_and_stretch
from .reading import armature_matrix, hand_armature, skinned_hand, weights_digest
from .store import StoredHand

_TOLERANCE = 1e-4
"""Smaller changes of position than this, relative to the hand's length, are ignored."""


def changed_part(context: bpy.types.Context, item: bpy.types.Object, stored: StoredHand) -> str:
    """Describe what has changed since binding, for a message; empty if nothing has.

    Raises:
        HandError: The object is no longer a rigged mesh, or Blender does not evaluate it.
    """
    now = skinned_hand(context, item)
    world = armature_matrix(hand_armature(item), context.evaluated_depsgraph_get())
    rig = stored.rig
    order = {name: index for index, name in enumerate(now.bone_names)}
    if set(order) != set(rig.bone_names):
        return "its bones have changed"
    tolerance = _TOLERANCE * float(np.ptp(rig.vertices, axis=0).max())
    _, stretch = rotation_and_stretch(world[:3, :3])
    _, before = rotation_and_stretch(stored.armature[:3, :3])
    if not np.allclose(stretch, before, rtol=0.0, atol=_TOLERANCE * np.abs(before).max()):
        return "its size has changed"
    # Compare relative to the armature, which may have moved.
    back = stored.armature @ np.linalg.inv(world)
    rest = back @ now.bone_rest[[order[name] for name in rig.bone_names]]
    if np.abs(rest[:, :3, 3] - rig.bone_rest[:, :3, 3]).max() > tolerance or not np.allclose(
        rest[:, :3, :3], rig.bone_rest[:, :3, :3], rtol=0.0, atol=1e-3
    ):
        return "its armature's rest pose has changed"
    if now.vertices.shape != rig.vertices.shape or not np.array_equal(now.faces, rig.faces):
        return "its mesh has changed"
    moved = now.vertices @ back[:3, :3].T + back[:3, 3]
    if np.abs(moved - rig.vertices).max() > tolerance:
        return "its mesh has changed, or has moved relative to its armature"
    if weights_digest(now) != stored.weights_digest:
        return "its vertex weights have changed"
    return ""


def source_digest(item: bpy.types.Object) -> str:
    """Hash a hand's mesh, rest bones and scale, independent of its pose and location.

    Fast and without side effects, so that panels can call it. Vertex weights and most settings of
    modifiers are left out, because they take longer.

    Returns:
        32 hexadecimal digits.

    Raises:
        HandError: The object is not rigged.
    """
    rig = hand_armature(item)
    mesh = item.data
    digest = hashlib.blake2b(digest_size=16)
    positions = np.empty((len(mesh.vertices), 3), np.float32)
    if len(positions):
        mesh.attributes["position"].data.foreach_get("vector", positions.ravel())
    corners = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    names = [group.name for group in item.vertex_groups]
    bones = [(bone.name, bone.use_deform, *np.ravel(bone.matrix_local)) for bone in rig.data.bones]
    modifiers = [(m.type, m.show_viewport) for m in item.modifiers]
    _, stretch = rotation_and_stretch(np.array(rig.matrix_world, np.float64)[:3, :3])
    digest.update(positions.tobytes())
    digest.update(corners.tobytes())
    digest.update(repr((names, bones, modifiers, (np.round(stretch, 4) + 0.0).tolist())).encode())
    return digest.hexdigest()
