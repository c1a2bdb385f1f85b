# SPDX-License-Identifier: GPL-3.0-or-later
"""The object that plays a delivery with a Mesh Sequence Cache and nodes, without the add-on."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import bpy
import numpy as np

from ..base.clock import animation_time, drive_frame
from ..base.keyed_channels import CONSTANT, Channel, write_channels
from ..clay.look import set_input
from ..clay.look_material import clay_material
from ..playback.shown_clay import world_spacing
from .files import FRAMES_FOLDER, POINTS_PATH, ROOT_NAME
from .nodes import finish_group

OBJECT_NAME = "Clay Delivery"
POINTS_NAME = "Clay Delivery Points"
MODIFIER_NAME = "Clay Delivery"
_MARK = "tactile_clay_delivery"
_POINTS_MARK = "tactile_clay_delivery_points"
_HIDDEN_MARK = "tactile_clay_delivered"
"""Custom property of clay hidden by a delivery: whether it was visible in renders before."""


def delivered_object(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """The object of a scene that plays a delivery; None if there is none."""
    return next((item for item in scene.objects if item.get(_MARK)), None)


def close_delivery(scene: bpy.types.Scene) -> None:
    """Close the files of a delivery; the object that played them remains, and shows nothing."""
    for item in (delivered_object(scene), _points_object(scene)):
        for modifier in item.modifiers if item else ():
            if modifier.type == "MESH_SEQUENCE_CACHE" and modifier.cache_file is not None:
                cache_file = modifier.cache_file
                modifier.cache_file = None
                if cache_file.users == 0:
                    bpy.data.batch_remove([cache_file])


def show_delivery(
    scene: bpy.types.Scene,
    clay: Sequence[bpy.types.Object],
    folder: Path,
    kind: str,
    shapes: Mapping[int, str],
    object_path: str,
    *,
    points: bool = False,
) -> bpy.types.Object:
    """Hide the clay and play a delivery in its place.

    An object that played an earlier delivery is reused, with its current material and modifiers.

    Args:
        scene: Scene of the clay.
        clay: The delivered clay objects.
        folder: Folder of the delivery.
        kind: ``usd`` or ``abc``.
        shapes: Name of the file shown at each frame.
        object_path: Path of the surface within a file.
        points: Whether the files contain particles, for which a hidden object is added.

    Returns:
        The object that plays the surface.
    """
    close_delivery(scene)
    item = delivered_object(scene) or _new_object(scene, clay)
    item[_MARK] = kind
    first = f"{FRAMES_FOLDER}/{shapes[min(shapes)]}"
    cache_file = _open(folder / (ROOT_NAME if kind == "usd" else first))
    if kind == "abc":
        _play_sequence(scene, cache_file, shapes)
    else:
        # By itself it would go by the animation time, which time remapping stretches.
        cache_file.override_frame = True
        drive_frame(cache_file, "frame")
    _play(item, cache_file, object_path)
    cloud = _points_object(scene)
    if points:
        _play(cloud or _new_points(scene), cache_file, POINTS_PATH)
    elif cloud is not None:
        _remove(cloud)
    for part in clay:
        if _HIDDEN_MARK not in part:
            part[_HIDDEN_MARK] = not part.hide_render
        part.hide_render = True
        # Fails if the collection is excluded from the view layer.
        with contextlib.suppress(RuntimeError):
            part.hide_set(True)
    return item


def remove_delivery(scene: bpy.types.Scene) -> bool:
    """Show the clay again in place of the delivery. The files remain on disk.

    Returns:
        Whether a delivery was shown.
    """
    item = delivered_object(scene)
    close_delivery(scene)
    for player in (item, _points_object(scene)):
        if player is not None:
            _remove(player)
    for part in scene.objects:
        if _HIDDEN_MARK in part:
            part.hide_render = not part[_HIDDEN_MARK]
            del part[_HIDDEN_MARK]
            with contextlib.suppress(RuntimeError):
                part.hide_set(False)
    return item is not None


def _points_object(scene: bpy.types.Scene) -> bpy.types.Object | None:
    return next((item for item in scene.objects if item.get(_POINTS_MARK)), None)


def _new_points(scene: bpy.types.Scene) -> bpy.types.Object:
    item = bpy.data.objects.new(POINTS_NAME, bpy.data.pointclouds.new(POINTS_NAME))
    item[_POINTS_MARK] = True
    scene.collection.objects.link(item)
    item.modifiers.new("Mesh Sequence Cache", "MESH_SEQUENCE_CACHE")
    # The points are inside the surface.
    item.hide_render = True
    with contextlib.suppress(RuntimeError):
        item.hide_set(True)
    return item


def _play(item: bpy.types.Object, cache_file: bpy.types.CacheFile, path: str) -> None:
    player = next((m for m in item.modifiers if m.type == "MESH_SEQUENCE_CACHE"), None)
    if player is None:
        player = item.modifiers.new("Mesh Sequence Cache", "MESH_SEQUENCE_CACHE")
        item.modifiers.move(len(item.modifiers) - 1, 0)
    player.cache_file = cache_file
    player.object_path = path


def _remove(item: bpy.types.Object) -> None:
    data = item.data
    bpy.data.objects.remove(item)
    if data.users == 0:
        bpy.data.batch_remove([data])


def _new_object(scene: bpy.types.Scene, clay: Sequence[bpy.types.Object]) -> bpy.types.Object:
    item = bpy.data.objects.new(OBJECT_NAME, bpy.data.meshes.new(OBJECT_NAME))
    scene.collection.objects.link(item)
    item.modifiers.new("Mesh Sequence Cache", "MESH_SEQUENCE_CACHE")
    modifier = item.modifiers.new(MODIFIER_NAME, "NODES")
    modifier.node_group = finish_group()
    material = clay[0].active_material or clay_material()
    item.data.materials.append(material)
    set_input(modifier, "Material", material)
    set_input(modifier, "Spacing", world_spacing(clay[0]))
    return item


def _open(path: Path) -> bpy.types.CacheFile:
    before = set(bpy.data.cache_files)
    bpy.ops.cachefile.open(filepath=str(path))
    (cache_file,) = set(bpy.data.cache_files) - before
    # The operator adds a user, so that the file would never be closed.
    cache_file.user_clear()
    if bpy.data.filepath:
        with contextlib.suppress(ValueError):
            cache_file.filepath = bpy.path.relpath(str(path))
    return cache_file


def _play_sequence(
    scene: bpy.types.Scene, cache_file: bpy.types.CacheFile, shapes: Mapping[int, str]
) -> None:
    """Let a file of each shape be opened at the frames at which it is shown."""
    cache_file.is_sequence = True
    cache_file.override_frame = True
    numbers = [int(shapes[frame].rpartition("_")[2].partition(".")[0]) for frame in shapes]
    times = np.array([animation_time(scene, frame) for frame in shapes])
    channel = Channel("frame", 0, times, np.array(numbers), CONSTANT)
    write_channels(cache_file, cache_file.name, [channel])
