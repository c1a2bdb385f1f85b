# SPDX-License-Identifier: GPL-3.0-or-later
"""Copies of scenes that share most objects with the original."""

from __future__ import annotations

from collections.abc import Iterable

import bpy

COLLECTION = "Film"
_MARK = "clay_film"
"""Custom property that marks data made for a film, so that it can be replaced."""


def copy_scene(source: bpy.types.Scene, name: str) -> bpy.types.Scene:
    """Copy a scene's settings, and link its collections and objects into the copy."""
    scene = source.copy()
    scene.name = name
    # Without a user, the copy would not be saved.
    scene.use_fake_user = True
    return scene


def film_collection(film: bpy.types.Scene) -> bpy.types.Collection:
    """The collection of a film's own objects, created if missing."""
    for collection in film.collection.children:
        if collection.get(_MARK) == COLLECTION:
            return collection
    collection = bpy.data.collections.new(COLLECTION)
    collection[_MARK] = COLLECTION
    film.collection.children.link(collection)
    return collection


def remove_film_objects(film: bpy.types.Scene) -> None:
    """Delete the objects made for a film."""
    for item in list(film_collection(film).objects):
        if item.get(_MARK) or item.tactile_clay.role == "CLAY":
            data = item.data
            bpy.data.objects.remove(item)
            if data is not None and not data.users:
                bpy.data.batch_remove([data])


def copy_objects(
    source: bpy.types.Scene,
    film: bpy.types.Scene,
    objects: Iterable[bpy.types.Object],
    *,
    excluded: Iterable[bpy.types.Object],
) -> dict[bpy.types.Object, bpy.types.Object]:
    """Replace objects in a film, and all objects parented to or deformed by them, with copies.

    The copies share the data and actions of the originals. References between the originals become
    references between the copies.

    Args:
        source: The original of the film.
        film: Scene to put the copies into.
        objects: Objects in both scenes.
        excluded: Objects to remove from the film without a copy.

    Returns:
        The copies by original.
    """
    originals = dict.fromkeys(objects)
    while dependents := [
        item
        for item in source.objects
        if item not in originals and (item.parent in originals or _deformer(item) in originals)
    ]:
        originals.update(dict.fromkeys(dependents))
    removed = set(excluded)
    copies = {item: item.copy() for item in originals if item not in removed}
    collection = film_collection(film)
    for item, copy in copies.items():
        copy[_MARK] = True
        collection.objects.link(copy)
        _retarget(copy, copies)
        hidden = item.name in source.view_layers[0].objects and item.hide_get(
            view_layer=source.view_layers[0]
        )
        if hidden:
            copy.hide_set(True, view_layer=film.view_layers[0])
    _unlink(film, source, {*copies, *removed})
    return copies


def _deformer(item: bpy.types.Object) -> bpy.types.Object | None:
    return next((m.object for m in item.modifiers if m.type == "ARMATURE" and m.object), None)


def _retarget(copy: bpy.types.Object, copies: dict[bpy.types.Object, bpy.types.Object]) -> None:
    """Replace references of a copy to originals by references to their copies."""
    if copy.parent in copies:
        inverse = copy.matrix_parent_inverse.copy()
        copy.parent = copies[copy.parent]
        copy.matrix_parent_inverse = inverse
    owners = [*copy.modifiers, *copy.constraints]
    if copy.type == "ARMATURE":
        owners += [each for bone in copy.pose.bones for each in bone.constraints]
    for owner in owners:
        for prop in owner.bl_rna.properties:
            if prop.type != "POINTER" or prop.is_readonly:
                continue
            value = getattr(owner, prop.identifier, None)
            if isinstance(value, bpy.types.Object) and value in copies:
                setattr(owner, prop.identifier, copies[value])


def _unlink(film: bpy.types.Scene, source: bpy.types.Scene, removed: set[bpy.types.Object]) -> None:
    """Unlink objects from a film's collections, after copying shared collections."""
    replaced: dict[bpy.types.Collection, bpy.types.Collection] = {}

    def unlink_from(collection: bpy.types.Collection) -> None:
        for item in list(collection.objects):
            if item in removed:
                collection.objects.unlink(item)
        for child in list(collection.children):
            if not any(item in removed for item in child.all_objects):
                continue
            own = child
            if child.get(_MARK) is None:
                own = replaced[child] = child.copy()
                own[_MARK] = True
                collection.children.unlink(child)
                collection.children.link(own)
            unlink_from(own)
            if own != child and not own.all_objects:
                # It contained only removed objects.
                bpy.data.collections.remove(replaced.pop(child))

    unlink_from(film.collection)
    if replaced:
        for layer in film.view_layers:
            original = source.view_layers.get(layer.name)
            if original is not None:
                _copy_visibility(original.layer_collection, layer.layer_collection, replaced)


def _copy_visibility(
    original: bpy.types.LayerCollection,
    copy: bpy.types.LayerCollection,
    replaced: dict[bpy.types.Collection, bpy.types.Collection],
) -> None:
    """Copy the visibility of collections from one view layer to another."""
    copies = {child.collection: child for child in copy.children}
    for child in original.children:
        child_copy = copies.get(replaced.get(child.collection, child.collection))
        if child_copy is not None:
            child_copy.exclude = child.exclude
            child_copy.hide_viewport = child.hide_viewport
            _copy_visibility(child, child_copy, replaced)
