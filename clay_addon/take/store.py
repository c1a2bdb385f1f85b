# SPDX-License-Identifier: GPL-3.0-or-later
"""A take in a .blend: keyframes, the clay at its start, its edits, and where its frames are."""

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
from ..simulate.edited_clay import edits_of_text, edits_text
from .keys import key_take

_MAX_SAMPLE_SECONDS = 1 / 60
"""Longest time between samples of hands and tools when a take is baked again [s]."""


class Stored(NamedTuple):
    """What was put into the .blend."""

    directory: Path
    """Where its files are."""
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
) -> Stored:
    """Put a take on a scene's timeline.

    Args:
        scene: The take's.
        directory: Its folder; it may have been cut short.
        unwritten: Steps that are not in the folder, by the number of their file.

    Raises:
        CacheError: The folder holds no take, or it is damaged.
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
            _keep_start(clay[name], positions, colors)
        else:
            warnings.append(f"The clay {name!r} of the take cannot be found in this file.")
    properties = scene.tactile_clay
    rate = take.header.frames_per_second
    properties.take_edits = edits_text(take.edits, start=keyed.first, rate=rate)
    properties.motion_samples = max(1, math.ceil(1.0 / (rate * _MAX_SAMPLE_SECONDS) - 1e-6))
    properties.cache_directory = beside_blend(directory, properties.cache_directory)
    scene.frame_start, scene.frame_end = keyed.first, keyed.last
    properties.use_scene_range = True
    for item in clay.values():
        # These frames show what was sculpted.
        item.data.pop(SCULPTED_MARK, None)
    scene.frame_set(keyed.last)
    refresh(scene)
    return Stored(directory, keyed.first, keyed.last, keyed.objects, tuple(warnings))


def take_start(
    item: bpy.types.Object,
) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
    """The clay of an object at the start of its last take; None without a take.

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
    return edits_of_text(scene.tactile_clay.take_edits)


def _keep_start(
    item: bpy.types.Object, positions: NDArray[np.float32], colors: NDArray[np.float32]
) -> None:
    """Keep the clay at the start of a take in the .blend.

    It is in a hidden mesh, since the clay object may have a different number of points by now.
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


def beside_blend(directory: Path, like: str) -> str:
    """A folder as a property stores it: relative to the .blend if it was so before."""
    if like.startswith("//") and bpy.data.filepath:
        try:
            return str(bpy.path.relpath(str(directory)))
        except ValueError:
            # On another drive.
            pass
    return str(directory)
