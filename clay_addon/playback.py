# SPDX-License-Identifier: GPL-3.0-or-later
"""Playback: the baked frame is written into the point cloud whenever the frame changes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy
import numpy as np
from bpy.app.handlers import persistent
from numpy.typing import NDArray

from .cache import Cache, CacheError, CacheMissingError, Meta
from .mesh_geometry import transform
from .pack import is_packed
from .simulation import clay_objects, read_points

_messages: dict[str, str] = {}
_metas: dict[Path, tuple[int, Meta]] = {}
_pauses = 0


def cache_of(scene: bpy.types.Scene) -> Cache | None:
    """The scene's cache; None where its folder is beside a .blend that was not saved yet."""
    folder = scene.tactile_clay.cache_directory
    if not folder or (folder.startswith("//") and not bpy.data.filepath):
        return None
    return Cache(bpy.path.abspath(folder))


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


def show_rest(scene: bpy.types.Scene) -> None:
    """Show the clay as it was before it was baked."""
    for item in clay_objects(scene):
        rest = read_points(item, "rest_position")
        if rest is not None:
            _write(item, rest)


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
    meta = _meta(cache)
    expected = [(part.name, part.count) for part in meta.clay]
    if expected != [(item.name, len(item.data.points)) for item in clay]:
        show_rest(scene)
        names = ", ".join(f"{name} ({count:,} particles)" for name, count in expected)
        raise CacheError(f"the bake is of other clay: {names}. Bake again")
    wanted = min(max(scene.frame_current, frames[0]), frames[-1])
    if wanted not in frames:
        raise CacheMissingError("it is missing in the bake. Press Resume")
    positions = cache.read_frame(wanted, meta=meta).positions
    first = 0
    for item in clay:
        count = len(item.data.points)
        inverse = np.linalg.inv(np.array(item.matrix_world, np.float64))
        _write(item, transform(inverse, positions[first : first + count]))
        first += count


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


def _write(item: bpy.types.Object, local: NDArray[np.floating]) -> None:
    values = np.ascontiguousarray(local, np.float32).ravel()
    item.data.attributes["position"].data.foreach_set("vector", values)
    item.data.update_tag()


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
    for name, handler in _HANDLERS:
        handlers = getattr(bpy.app.handlers, name)
        if handler not in handlers:
            handlers.append(handler)


def unregister() -> None:
    """Remove the handlers."""
    for name, handler in _HANDLERS:
        handlers = getattr(bpy.app.handlers, name)
        if handler in handlers:
            handlers.remove(handler)
    _messages.clear()
    _metas.clear()
