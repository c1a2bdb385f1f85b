# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks before a bake starts or resumes: its folder, its owner, and changes to the scene."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import bpy

from ...solver.core.errors import TactileClayError
from ..core.storage.cache import Cache, CacheDamagedError, CacheError, Frame, Meta
from ..model.cache_folder import CacheFolderError, resolve_directory
from ..simulate.simulation import Simulation


class BakeError(TactileClayError):
    """A bake cannot start or continue; the message says why and what to do."""


class BakeStaleError(BakeError):
    """The scene has changed since the bake."""


def bake_cache(scene: bpy.types.Scene, directory: str | os.PathLike[str] | None = None) -> Cache:
    """The cache for a bake of a scene.

    Raises:
        BakeError: The scene has no usable cache folder; see `resolve_directory`.
    """
    try:
        return Cache(resolve_directory(scene, directory))
    except CacheFolderError as error:
        raise BakeError(str(error)) from error


def check_owner(scene: bpy.types.Scene, cache: Cache, *, replace_other: bool) -> None:
    """Refuse to overwrite a take, or a bake that another .blend or scene still uses.

    Raises:
        BakeError: The cache holds such a take or bake.
    """
    if replace_other or not cache.exists():
        return
    try:
        meta = cache.meta()
    except CacheError:
        return
    owner = meta.owner
    if meta.is_take:
        raise BakeError(
            f"The cache folder {cache.directory} holds a recorded take, which would be lost. Press "
            "Bake Again to bake the take, or choose another cache folder."
        )
    blend, _, scene_name = owner.rpartition("|")
    path = cache.directory / blend
    if not blend or not path.exists():
        return
    current = bpy.data.filepath
    same_file = bool(current) and Path(current).exists() and path.samefile(current)
    if same_file and (scene_name == scene.name or scene_name not in bpy.data.scenes):
        return
    raise BakeError(
        f"The cache folder {cache.directory} holds the bake of "
        f"{path.name if not same_file else f'scene {scene_name!r}'}, which would be lost. Choose "
        "another cache folder."
    )


def check_resume(
    scene: bpy.types.Scene, simulation: Simulation, cache: Cache, meta: Meta
) -> dict[int, Frame]:
    """The intact frames to resume from.

    Raises:
        BakeStaleError: The scene has changed since the bake, or the bake is damaged.
    """
    try:
        old = cache.meta()
        if old.start != meta.start:
            change = f"it starts at frame {old.start}, not at {meta.start}"
        else:
            change = compare(scene, simulation, cache, meta.settings)
    except CacheDamagedError as error:
        change = f"it cannot be used ({error})"
    if change:
        raise BakeStaleError(
            f"The bake in {cache.directory} is stale: {change}. Bake again to start over, or undo "
            "the change and resume."
        )
    return cache.intact_frames(meta.start, meta.end)


def compare(
    scene: bpy.types.Scene, simulation: Simulation, cache: Cache, settings: Mapping[str, str]
) -> str:
    """Describe what has changed in the scene since the bake; empty if nothing has.

    Moves the scene through the baked frames to compare the motion of colliders and hands, and
    leaves it at the last one.

    Raises:
        CacheError: There is no bake, or its meta.json is damaged.
        SimulationError: A collider has changed in an unsupported way, or a hand is missing.
    """
    meta = cache.meta()
    if meta.is_take:
        return ""
    changed = changed_subjects(meta, settings)
    if changed:
        return f"the scene has changed: {', '.join(changed)}"
    for number, frame in cache.intact_frames(meta.start, meta.end).items():
        if number == meta.start:
            scene.frame_set(number)
            inputs = simulation.feed(bpy.context.evaluated_depsgraph_get())
        else:
            inputs = simulation.advance_to(number, step_solver=False)
        if inputs != frame.inputs:
            parts = simulation.moving_parts()
            return f"the {parts} motion changed, first at frame {number}"
    return ""


def changed_subjects(meta: Meta, digests: Mapping[str, str]) -> list[str]:
    """Subjects whose digest has changed since the bake; none for a take."""
    if meta.is_take:
        return []
    return [name for name, value in digests.items() if meta.settings.get(name) != value]
