# SPDX-License-Identifier: GPL-3.0-or-later
"""Copies of scenes that share all but some objects with the original."""

from __future__ import annotations

from collections.abc import Iterable

import bpy

COLLECTION = "Film"
_MARK = "clay_film"
"""Custom property of what was made for a film, so that it can be replaced."""


def copy_scene(source: bpy.types.Scene, name: str) -> bpy.types.Scene:
    """Copy a scene's settings, and link its collections and objects into the copy."""
    scene = source.copy()
    scene.name = name
    # Otherwise the copy has no user and is not saved.
    scene.use_fake_user = True
    return scene


def film_collection(film: bpy.types.Scene) -> bpy.types.Collection:
    """The collection of the film's own objects."""
    for collection in film.collection.children:
        if collection.get(_MARK) == COLLECTION:
            return collection
    collection = bpy.data.collections.new(COLLECTION)
    collection[_MARK] = COLLECTION
    film.collection.children.link(collection)
    return collection


def drop_objects(film: bpy.types.Scene) -> None:
    """Delete what was made for a film; other objects stay."""
    for item in list(film_collection(film).objects):
        if item.get(_MARK) or item.tactile_clay.role == "CLAY":
            data = item.data
            bpy.data.objects.remove(item)
            if data is not None and not data.users:
                bpy.data.batch_remove([data])


def twins(
    source: bpy.types.Scene,
    film: bpy.types.Scene,
    chosen: Iterable[bpy.types.Object],
    *,
    left_out: Iterable[bpy.types.Object],
) -> dict[bpy.types.Object, bpy.types.Object]:
    """Give a film copies of objects, and of all that hangs on them, in place of the objects.

    The copies share meshes, armatures and actions with the objects, and refer to each other where
    those do.

    Args:
        source: The film's scene is a copy of this one.
        film: Where the copies go.
        chosen: Objects of both.
        left_out: Objects that the film does not get.
    """
    wanted = dict.fromkeys(chosen)
    grown = True
    while grown:
        found = [
            item
            for item in source.objects
            if item not in wanted and (item.parent in wanted or _deformer(item) in wanted)
        ]
        wanted.update(dict.fromkeys(found))
        grown = bool(found)
    gone = set(left_out)
    made = {item: item.copy() for item in wanted if item not in gone}
    collection = film_collection(film)
    for item, copy in made.items():
        copy[_MARK] = True
        collection.objects.link(copy)
        _refer(copy, made)
        hidden = item.name in source.view_layers[0].objects and item.hide_get(
            view_layer=source.view_layers[0]
        )
        if hidden:
            copy.hide_set(True, view_layer=film.view_layers[0])
    _leave_out(film, source, {*made, *gone})
    return made


def _deformer(item: bpy.types.Object) -> bpy.types.Object | None:
    return next((m.object for m in item.modifiers if m.type == "ARMATURE" and m.object), None)


def _refer(copy: bpy.types.Object, made: dict[bpy.types.Object, bpy.types.Object]) -> None:
    """Make a copy refer to copies."""
    if copy.parent in made:
        inverse = copy.matrix_parent_inverse.copy()
        copy.parent = made[copy.parent]
        copy.matrix_parent_inverse = inverse
    owners = [*copy.modifiers, *copy.constraints]
    if copy.type == "ARMATURE":
        owners += [each for bone in copy.pose.bones for each in bone.constraints]
    for owner in owners:
        for prop in owner.bl_rna.properties:
            if prop.type != "POINTER" or prop.is_readonly:
                continue
            value = getattr(owner, prop.identifier, None)
            if isinstance(value, bpy.types.Object) and value in made:
                setattr(owner, prop.identifier, made[value])


def _leave_out(film: bpy.types.Scene, source: bpy.types.Scene, gone: set[bpy.types.Object]) -> None:
    """Take objects out of a film's collections, copying those that are shared."""
    replaced: dict[bpy.types.Collection, bpy.types.Collection] = {}

    def thin(collection: bpy.types.Collection) -> None:
        for item in list(collection.objects):
            if item in gone:
                collection.objects.unlink(item)
        for child in list(collection.children):
            if not any(item in gone for item in child.all_objects):
                continue
            own = child
            if child.get(_MARK) is None:
                own = replaced[child] = child.copy()
                own[_MARK] = True
                collection.children.unlink(child)
                collection.children.link(own)
            thin(own)
            if own != child and not own.all_objects:
                # It held only objects that the film does not have.
                bpy.data.collections.remove(replaced.pop(child))

    thin(film.collection)
    if replaced:
        for layer in film.view_layers:
            before = source.view_layers.get(layer.name)
            if before is not None:
                _copy_switches(before.layer_collection, layer.layer_collection, replaced)


def _copy_switches(
    before: bpy.types.LayerCollection,
    after: bpy.types.LayerCollection,
    replaced: dict[bpy.types.Collection, bpy.types.Collection],
) -> None:
    """Switch collections on and off in one view layer as in another."""
    own = {each.collection: each for each in after.children}
    for child in before.children:
        twin = own.get(replaced.get(child.collection, child.collection))
        if twin is not None:
            twin.exclude = child.exclude
            twin.hide_viewport = child.hide_viewport
            _copy_switches(child, twin, replaced)
