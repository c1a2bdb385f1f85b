# SPDX-License-Identifier: GPL-3.0-or-later
"""A take in a .blend: keyframes, the clay at its start, its edits, and the folder of its frames."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import bpy
import numpy as np
from numpy.typing import NDArray

from ..core.take.data import Steps, TakeEdit
from ..core.take.files import read_take
from ..model.clay_points import SCULPTED_MARK
from ..model.clay_scene import clay_objects
from ..playback.playback import refresh
from ..simulate.edited_clay import edits_from_text, edits_to_text
from .keys import key_take

_MAX_SAMPLE_SECONDS = 1 / 60
"""Maximum sampling interval of hands and tools when a take is baked again [s]."""


class StoredTake(NamedTuple):
    """Result of `store_take`."""

    directory: Path
    """Folder of the take."""
    first: int
    """First frame."""
    last: int
    """Last frame."""
    objects: tuple[str, ...]
    """Names of the objects that got keyframes."""
    warnings: tuple[str, ...] = ()
    """What the user should know."""


def store_take(
    scene: bpy.types.Scene, directory: Path, *, unwritten: Mapping[int, Steps] | None = None
) -> StoredTake:
    """Put a take on a scene's timeline.

    Args:
        scene: Scene of the take.
        directory: Folder of the take, which may have been interrupted.
        unwritten: Steps not yet in the folder, by file number.

    Raises:
        CacheError: The folder holds no take, or the take is damaged.
    """
    take = read_take(directory, unwritten=unwritten)
    warnings = []
    keyed = key_take(scene, take)
    if keyed.missing:
        names = ", ".join(repr(name) for name in keyed.missing)
        warnings.append(f"{names} of the take cannot be found in this file.")
    clay = {item.name: item for item in clay_objects(scene)}
    for name, (positions, colors) in take.start.items():
        if name in clay:
            _store_start(clay[name], positions, colors)
        else:
            warnings.append(f"The clay {name!r} of the take cannot be found in this file.")
    properties = scene.tactile_clay
    rate = take.header.frames_per_second
    properties.take_edits = edits_to_text(take.edits, start=keyed.first, rate=rate)
    properties.motion_samples = max(1, math.ceil(1.0 / (rate * _MAX_SAMPLE_SECONDS) - 1e-6))
    properties.cache_directory = stored_path(directory, properties.cache_directory)
    scene.frame_start, scene.frame_end = keyed.first, keyed.last
    properties.use_scene_range = True
    for item in clay.values():
        # The frames already show the sculpted shape.
        item.data.pop(SCULPTED_MARK, None)
    scene.frame_set(keyed.last)
    refresh(scene)
    return StoredTake(directory, keyed.first, keyed.last, keyed.objects, tuple(warnings))


def take_start(
    item: bpy.types.Object,
) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
    """The particles of a clay object at the start of its last take; None without a take.

    Returns:
        World positions [Blender units], shape [N, 3], and linear RGBA, shape [N, 4].
    """
    mesh = item.tactile_clay.take_start
    if mesh is None or not len(mesh.vertices):
        return None
    positions = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.attributes["position"].data.foreach_get("vector", positions.ravel())
    colors = np.ones((len(positions), 4), np.float32)
    layer = mesh.attributes.get("Color")
    if layer is not None and len(layer.data) == len(positions):
        layer.data.foreach_get("color", colors.ravel())
    return positions, colors


def take_edits(scene: bpy.types.Scene) -> list[TakeEdit]:
    """The edits of a scene's take, in the order they were made."""
    return edits_from_text(scene.tactile_clay.take_edits)


def _store_start(
    item: bpy.types.Object, positions: NDArray[np.float32], colors: NDArray[np.float32]
) -> None:
    """Store the particles of a clay object at the start of a take in the .blend.

    They are stored as a mesh without an object, since the clay object may have a different number
    of points by now.
    """
    before = item.tactile_clay.take_start
    mesh = bpy.data.meshes.new(f"{item.name} take start")
    mesh.vertices.add(len(positions))
    mesh.attributes["position"].data.foreach_set("vector", np.ascontiguousarray(positions).ravel())
    layer = mesh.attributes.new("Color", "FLOAT_COLOR", "POINT")
    layer.data.foreach_set("color", np.ascontiguousarray(colors, np.float32).ravel())
    item.tactile_clay.take_start = mesh
    if before is not None and not before.users:
        bpy.data.meshes.remove(before)


def stored_path(directory: Path, previous: str) -> str:
    """Path of a folder as stored in a property: relative to the .blend if the previous one was."""
    if previous.startswith("//") and bpy.data.filepath:
        try:
            return str(bpy.path.relpath(str(directory)))
        except ValueError:
            # On another drive.
            pass
    return str(directory)
