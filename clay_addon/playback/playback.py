# SPDX-License-Identifier: GPL-3.0-or-later
"""Playback: the baked frame is written into the point cloud whenever the frame changes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ..bake.checks import BakeError, resolve_directory
from ..base.app_handlers import add_handlers, remove_handlers
from ..base.mesh_geometry import local_from_world, transform
from ..core.storage.cache import Cache, CacheDamagedError, CacheError, CacheMissingError, Meta
from ..model.clay_points import BAKED_MARK, is_sculpted, write_points
from ..model.clay_scene import SimulationError, clay_objects, read_points
from ..model.digest import clay_digest
from ..model.properties import held_frame
from .pack import is_packed

_messages: dict[str, str] = {}
_metas: dict[Path, tuple[int, Meta]] = {}
_pauses = 0


def cache_of(scene: bpy.types.Scene) -> Cache | None:
    """The scene's cache; None where its folder cannot be told, as of a .blend never saved."""
    try:
        return Cache(resolve_directory(scene))
    except BakeError:
        return None


def message(scene: bpy.types.Scene) -> str:
    """What is wrong with the frame shown; empty where nothing is."""
    return _messages.get(scene.name, "")


def refresh(scene: bpy.types.Scene, *, during_bake: bool = False) -> None:
    """Show the baked frame at the scene's current frame, or the rest state before any bake.

    Args:
        scene: Where the clay is.
        during_bake: Show it although playback is `paused`.
    """
    clay = clay_objects(scene)
    if not clay or (_pauses and not during_bake):
        return
    if all(is_packed(item) for item in clay):
        # The file plays by itself, and must do so where the cache is gone.
        _messages.pop(scene.name, None)
        return
    try:
        _messages.pop(scene.name, None)
        _show(scene, clay)
    except CacheError as error:
        # The last good shape stays.
        _messages[scene.name] = f"Frame {scene.frame_current}: {error}."


def shown_frame(scene: bpy.types.Scene) -> int | None:
    """The baked frame shown at the scene's current one; None where that is the rest state.

    Before the first baked frame that is the first, after the last the last; in between, one may be
    held for some frames.
    """
    if all(is_packed(item) for item in clay_objects(scene)):
        return scene.frame_current
    cache = cache_of(scene)
    frames = cache.frames() if cache else []
    return _wanted(scene, frames) if frames else None


def show_rest(scene: bpy.types.Scene) -> None:
    """Show the clay as it was before it was baked.

    What has been done to its points while it showed that (Apply Transform, Set Origin, Join, Edit
    Mode) belongs to it from now on.
    """
    for item in clay_objects(scene):
        rest = read_points(item, "rest_position")
        if rest is None:
            continue
        shown = read_points(item, "position")
        if BAKED_MARK in item.data or shown is None or not np.isfinite(shown).all():
            write_points(item, rest)
            item.data.pop(BAKED_MARK, None)
        elif not np.array_equal(shown, rest):
            write_points(item, shown, "rest_position")


@contextmanager
def paused() -> Iterator[None]:
    """Leave the point clouds alone while the frame changes inside the context."""
    global _pauses
    _pauses += 1
    try:
        yield
    finally:
        _pauses -= 1


def _show(scene: bpy.types.Scene, clay: list[bpy.types.Object]) -> None:
    cache = cache_of(scene)
    frames = cache.frames() if cache else []
    if cache is None or not frames:
        show_rest(scene)
        return
    if any(is_sculpted(item) for item in clay):
        show_rest(scene)
        raise CacheError("the clay was sculpted since it was baked. Bake again, or undo")
    try:
        meta = _meta(cache)
    except CacheError as error:
        raise CacheError(f"{error}. Bake again") from error
    if not is_bake_of(meta, clay):
        show_rest(scene)
        names = ", ".join(f"{part.name} ({part.count:,} particles)" for part in meta.clay)
        raise CacheError(f"the bake is of other clay: {names}. Bake again")
    wanted = _wanted(scene, frames)
    if wanted not in frames:
        raise CacheMissingError("it is missing in the bake. Press Resume")
    try:
        positions = cache.read_frame(wanted, meta=meta).positions
        inverse = [local_from_world(item) for item in clay]
    except CacheDamagedError as error:
        raise CacheDamagedError(f"{error}. Press Resume to bake it again") from error
    except ValueError as error:
        raise CacheError(str(error)) from error
    for item, matrix, rows in zip(clay, inverse, meta.layout.split(positions), strict=True):
        write_points(item, transform(matrix, rows))
        if BAKED_MARK not in item.data:
            item.data[BAKED_MARK] = True


def _wanted(scene: bpy.types.Scene, frames: list[int]) -> int:
    return held_frame(scene, min(max(scene.frame_current, frames[0]), frames[-1]), frames[0])


def is_bake_of(meta: Meta, clay: list[bpy.types.Object]) -> bool:
    """Whether a bake is of these clay objects; they may have been renamed since."""
    counts = [len(item.data.points) for item in clay]
    if [part.count for part in meta.clay] != counts:
        return False
    if [part.name for part in meta.clay] == [item.name for item in clay]:
        return True
    try:
        return meta.settings.get("clay") == clay_digest(clay)
    except SimulationError:
        return False


def _meta(cache: Cache) -> Meta:
    """The bake's meta.json, read again only when it has changed."""
    try:
        stamp = (cache.directory / "meta.json").stat().st_mtime_ns
    except OSError:
        return cache.meta()
    known = _metas.get(cache.directory)
    if known is None or known[0] != stamp:
        known = _metas[cache.directory] = (stamp, cache.meta())
    return known[1]


@persistent
def _on_frame_change(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    refresh(scene)


@persistent
def _on_reload(*_: object) -> None:
    _messages.clear()
    _metas.clear()
    for scene in bpy.data.scenes:
        if clay_objects(scene):
            # Right after loading, and after Undo, the objects' world matrices are not there yet.
            for layer in scene.view_layers:
                layer.update()
            refresh(scene)


_HANDLERS = (
    ("frame_change_post", _on_frame_change),
    ("load_post", _on_reload),
    ("undo_post", _on_reload),
    ("redo_post", _on_reload),
)


def register() -> None:
    """Add the handlers, each once."""
    add_handlers(_HANDLERS)


def unregister() -> None:
    """Remove the handlers."""
    remove_handlers(_HANDLERS)
    _messages.clear()
    _metas.clear()
