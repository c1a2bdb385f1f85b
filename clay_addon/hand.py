# SPDX-License-Identifier: GPL-3.0-or-later
"""Clay hands: rigged meshes that work the clay, bound once and posed by their armature."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import bmesh
import bpy
import numpy as np
from numpy.typing import NDArray

from ..solver.hand_rig import HandRig
from ..solver.polar import rotation_and_stretch
from ..solver.skinned_hand import SkinnedHand
from .hand_store import StoredHand, forget_hand, is_stored, load_hand, store_hand
from .mesh_geometry import SWITCHED_OFF, is_switched_off, transform, turn_for
from .preferences import missing_parts

_SAME_PLACE = 1e-5
"""Vertices closer than this share of the hand's length are one: seams of textures."""
_UNCHANGED = 1e-4
"""A hand whose vertices moved by less than this share of its length is the one that was bound."""


class HandError(Exception):
    """An object cannot be a clay hand; the message says why and what to do."""


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
    from ..solver.hand_binding import bind_hand

    scale = context.scene.unit_settings.scale_length
    for sentence in missing_parts():
        raise HandError(sentence)
    if item.library is not None or item.data is not None and item.data.library is not None:
        raise HandError(
            f"{item.name!r} is linked from another file, so this one would not keep what is bound. "
            "Make it local (Object > Relations > Make Local), or bind it there."
        )
    hand = skinned_hand(context, item)
    hand = replace(hand, side=side or _side_of(item, hand))
    spacing = scene_spacing(context.scene) if clay_spacing is None else clay_spacing
    try:
        rig = bind_hand(hand, clay_spacing=spacing * scale)
    except ValueError as error:
        raise HandError(f"{item.name!r}: {error}") from error
    armature = _armature_matrix(hand_armature(item), context.evaluated_depsgraph_get(), scale)
    store_hand(item.data, StoredHand(rig, armature, _digest(hand.weights)))
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
    change = _changed(context, item, stored)
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
    scale = depsgraph.scene.unit_settings.scale_length
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
        matrix[:3, 3] *= scale
        matrices[bone.name] = matrix
    return matrices


def hand_message(context: bpy.types.Context, item: bpy.types.Object) -> str:
    """What is wrong with a clay hand, as a sentence; empty where nothing is."""
    try:
        rig = read_hand_rig(context, item)
    except HandError as error:
        return str(error)
    spacing = 2.0 * rig.ghost_spacing / context.scene.unit_settings.scale_length
    wanted = scene_spacing(context.scene)
    if abs(spacing - wanted) > 0.01 * wanted:
        return (
            f"{item.name!r} was bound for clay of another spacing. Press Make Clay Hand again, "
            "so that it fits this clay."
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


# Reading -----------------------------------------------------------------------------------------


def hand_armature(item: bpy.types.Object) -> bpy.types.Object:
    """The armature that carries a mesh.

    Raises:
        HandError: None does, or several.
    """
    if item.type != "MESH":
        raise HandError(f"{item.name!r} is no mesh ({item.type.lower()}). Select a hand's mesh.")
    rigs = {
        modifier.object
        for modifier in item.modifiers
        if modifier.type == "ARMATURE" and modifier.object is not None and modifier.show_viewport
    }
    if not rigs:
        raise HandError(
            f"{item.name!r} is not rigged: it has no Armature modifier that is switched on and "
            "names an armature. Parent it to one (Ctrl+P, With Automatic Weights)."
        )
    if len(rigs) > 1:
        raise HandError(f"{item.name!r} is carried by {len(rigs)} armatures; a hand has one.")
    (rig,) = rigs
    return rig


def skinned_hand(context: bpy.types.Context, item: bpy.types.Object) -> SkinnedHand:
    """A rigged mesh in its rest pose where it stands now, in world coordinates [m].

    Modifiers other than the armature are applied, and vertices at the same place are one, as the
    seams of an imported mesh have them. The object stays as it is.

    Raises:
        HandError: The object is no rigged mesh, or Blender does not evaluate it.
    """
    rig = hand_armature(item)
    depsgraph = context.evaluated_depsgraph_get()
    if item.mode == "EDIT":
        raise HandError(f"{item.name!r} is being edited. Leave Edit Mode first (Tab).")
    for part in (item, rig):
        if is_switched_off(part, depsgraph):
            raise HandError(f"{part.name!r} {SWITCHED_OFF}")
    scale = context.scene.unit_settings.scale_length
    bones = [bone for bone in rig.data.bones if bone.use_deform]
    column = {bone.name: index for index, bone in enumerate(bones)}
    groups = {
        group.index: column[group.name] for group in item.vertex_groups if group.name in column
    }
    if not groups:
        raise HandError(
            f"{item.name!r} has no vertex group named like a bone of {rig.name!r}, so no bone "
            "carries it. Parent it again (Ctrl+P, With Automatic Weights)."
        )
    places, triangles, weights = _rest_mesh(context, item, groups, len(bones))
    matrix = np.array(item.evaluated_get(depsgraph).matrix_world, np.float64)
    world = _armature_matrix(rig, depsgraph, scale)
    carrying = np.flatnonzero(weights.any(0)) if len(weights) else np.zeros(0, np.int64)
    if not len(carrying):
        raise HandError(f"{item.name!r} has no vertex that a bone of {rig.name!r} carries.")
    kept = [bones[index] for index in carrying]
    names = [bone.name for bone in kept]
    rest = np.stack([_scaled(bone.matrix_local, scale) for bone in kept])
    return SkinnedHand(
        vertices=transform(matrix, places) * scale if len(places) else places,
        faces=turn_for(matrix, triangles),
        bone_names=tuple(names),
        bone_rest=world @ rest,
        bone_parent=np.array([_parent_index(bone, names) for bone in kept], np.int32),
        weights=weights[:, carrying],
    )


def _parent_index(bone: bpy.types.Bone, names: list[str]) -> int:
    """Nearest ancestor that carries skin."""
    above = bone.parent
    while above is not None and above.name not in names:
        above = above.parent
    return -1 if above is None else names.index(above.name)


def _scaled(matrix: object, scale: float) -> NDArray[np.float64]:
    """A matrix with its translation in metres."""
    result = np.array(matrix, np.float64)
    result[:3, 3] *= scale
    return result


def _armature_matrix(
    rig: bpy.types.Object, depsgraph: bpy.types.Depsgraph, scale: float
) -> NDArray[np.float64]:
    return _scaled(rig.evaluated_get(depsgraph).matrix_world, scale)


def _rest_mesh(
    context: bpy.types.Context, item: bpy.types.Object, groups: dict[int, int], bone_count: int
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64]]:
    """Welded vertices in the object's coordinates, triangles and weights, at rest."""
    # A copy without the armature is at rest whatever the pose, also where the armature is linked.
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
    places = np.array([vertex.co for vertex in mesh.verts], np.float64).reshape(-1, 3)
    if len(places) and np.isfinite(places).all():
        distance = _SAME_PLACE * float(np.ptp(places, axis=0).max())
        bmesh.ops.remove_doubles(mesh, verts=mesh.verts[:], dist=distance)
        places = np.array([vertex.co for vertex in mesh.verts], np.float64).reshape(-1, 3)
    mesh.verts.index_update()
    triangles = np.array(
        [[loop.vert.index for loop in corners] for corners in mesh.calc_loop_triangles()], np.int32
    ).reshape(-1, 3)
    weights = np.zeros((len(places), bone_count))
    layer = mesh.verts.layers.deform.active
    if layer is not None:
        for vertex in mesh.verts:
            for group, weight in vertex[layer].items():
                if group in groups:
                    weights[vertex.index, groups[group]] = weight
    return places, triangles, weights


# What changed ------------------------------------------------------------------------------------


def _loaded(item: bpy.types.Object) -> StoredHand:
    if item.type != "MESH" or item.tactile_clay.role != "HAND" or not is_stored(item.data):
        raise HandError(f"{item.name!r} is no clay hand. Press Make Clay Hand.")
    try:
        return load_hand(item.data)
    except ValueError as error:
        raise HandError(f"{item.name!r}: {error}. Press Make Clay Hand again.") from error


def _changed(context: bpy.types.Context, item: bpy.types.Object, stored: StoredHand) -> str:
    """What differs from the time of binding, in words; empty where nothing does."""
    now = skinned_hand(context, item)
    scale = context.scene.unit_settings.scale_length
    world = _armature_matrix(hand_armature(item), context.evaluated_depsgraph_get(), scale)
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
    if _digest(now.weights) != stored.weights_digest:
        return "its vertex weights have changed"
    return ""


def _digest(weights: NDArray[np.float64]) -> str:
    rounded = np.ascontiguousarray(weights, np.float32)
    return hashlib.blake2b(rounded.tobytes(), digest_size=16).hexdigest()


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
