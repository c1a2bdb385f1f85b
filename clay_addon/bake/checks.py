# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a bake may start or go on: its folder, whose it is, and what has changed since."""

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
    """A bake cannot start or go on; the message says why and what to do."""


class BakeStaleError(BakeError):
    """The scene is no longer what the bake was made from."""


def bake_cache(scene: bpy.types.Scene, directory: str | os.PathLike[str] | None = None) -> Cache:
    """The cache that a bake of a scene goes into.

    Raises:
        BakeError: It has no usable folder; see `resolve_directory`.
    """
    try:
        return Cache(resolve_directory(scene, directory))
    except CacheFolderError as error:
        raise BakeError(str(error)) from error


def check_owner(scene: bpy.types.Scene, cache: Cache, *, replace_other: bool) -> None:
    """Refuse to touch a take, or a bake that another .blend or scene still uses."""
    if replace_other or not cache.exists():
        return
    try:
        meta = cache.meta()
    except CacheError:
        return
    owner = meta.owner
    if meta.is_take:
        raise BakeError(
            f"The cache folder {cache.directory} holds a recorded take. Bake Again bakes it "
            "elsewhere; for a bake of its own choose another cache folder, so that the take is "
            "not lost."
        )
    blend, _, scene_name = owner.rpartition("|")
    path = cache.directory / blend
    if not blend or not path.exists():
        return
    here = bpy.data.filepath
    same_file = bool(here) and Path(here).exists() and path.samefile(here)
    if same_file and (scene_name == scene.name or scene_name not in bpy.data.scenes):
        return
    raise BakeError(
        f"The cache folder {cache.directory} holds the bake of "
        f"{path.name if not same_file else f'scene {scene_name!r}'}. Choose another cache folder, "
        "so that it is not lost."
    )


def check_resume(
    scene: bpy.types.Scene, simulation: Simulation, cache: Cache, meta: Meta
) -> dict[int, Frame]:
    """The whole frames to go on from, if the scene is still what it was."""
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
    """What has changed in the scene since it was baked, in words; empty where nothing has.

    Moves the scene through the baked frames, to see what colliders and hands do there, and leaves
    it at the last one.

    Raises:
        CacheError: There is no bake, or its meta.json is damaged.
        SimulationError: A collider does what the solver cannot follow, or a hand is gone.
    """
    meta = cache.meta()
    if meta.is_take:
        return ""
    changed = changed_subjects(meta, settings)
    if changed:
        return f"since then changed: {', '.join(changed)}"
    for number, frame in cache.intact_frames(meta.start, meta.end).items():
        if number == meta.start:
            scene.frame_set(number)
            inputs = simulation.feed(bpy.context.evaluated_depsgraph_get())
        else:
            inputs = simulation.advance_to(number, step_solver=False)
        if inputs != frame.inputs:
            what = simulation.moving_parts()
            return f"since then the {what} motion changed, first at frame {number}"
    return ""


def changed_subjects(meta: Meta, digests: Mapping[str, str]) -> list[str]:
    """Subjects whose digest differs from what the bake was made with; none for a take."""
    if meta.is_take:
        return []
    return [name for name, value in digests.items() if meta.settings.get(name) != value]
