# SPDX-License-Identifier: GPL-3.0-or-later
"""Playback: writes the baked frame to the point clouds whenever the scene's frame changes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy
import numpy as np
from bpy.app.handlers import persistent
from numpy.typing import NDArray

from ..base.app_handlers import add_handlers, remove_handlers
from ..base.clock import shown_moment
from ..base.later import later
from ..base.mesh_geometry import local_from_world, transform
from ..base.signals import held_frames_changed
from ..core.storage.cache import Cache, CacheDamagedError, CacheError, CacheMissingError, Meta
from ..core.storage.playback import Playback
from ..core.storage.playback import shown_frame as baked_frame
from ..model.cache_folder import CacheFolderError, resolve_directory
from ..model.clay_points import BAKED_MARK, is_sculpted, write_points
from ..model.clay_scene import SimulationError, clay_objects, read_points
from ..model.digest import clay_digest
from .packed import is_packed


class PlaybackState:
    """State of playback that persists between frame changes."""

    def __init__(self) -> None:
        self.messages: dict[str, str] = {}
        """What is wrong with the displayed frame, by scene name."""
        self.pause_count = 0
        """Number of open `paused` contexts."""
        self._playbacks: dict[Path, Playback] = {}

    def playback(self, scene: bpy.types.Scene) -> Playback | None:
        """The playback of a scene's cache; None if the scene has no cache folder."""
        cache = cache_of(scene)
        if cache is None:
            return None
        return self._playbacks.setdefault(cache.directory, Playback(cache))

    def forget(self) -> None:
        """Drop all cached frames and messages."""
        self.messages.clear()
        self._playbacks.clear()


playback_state = PlaybackState()
"""One per process, as Blender's handlers cannot carry state."""


def cache_of(scene: bpy.types.Scene) -> Cache | None:
    """The scene's cache; None if it has no folder, as in a .blend that was never saved."""
    try:
        return Cache(resolve_directory(scene))
    except CacheFolderError:
        return None


def message(scene: bpy.types.Scene) -> str:
    """What is wrong with the displayed frame; empty if nothing is."""
    return playback_state.messages.get(scene.name, "")


def refresh(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph | None = None,
    *,
    during_bake: bool = False,
) -> None:
    """Show the baked frame at the scene's current frame, or the rest state before any bake.

    Args:
        scene: Where the clay is.
        depsgraph: What shows it; the viewport where not given.
        during_bake: Show it although playback is `paused`.
    """
    clay = clay_objects(scene)
    if not clay or (playback_state.pause_count and not during_bake):
        return
    if all(is_packed(item) for item in clay):
        # The .blend plays by itself, and must do so even without the cache.
        playback_state.messages.pop(scene.name, None)
        return
    try:
        playback_state.messages.pop(scene.name, None)
        _show(scene, clay, depsgraph)
    except CacheError as error:
        # The last good shape stays visible.
        playback_state.messages[scene.name] = f"Frame {scene.frame_current}: {error}."


def shown_frame(scene: bpy.types.Scene) -> int | None:
    """The baked frame shown at the scene's current frame; None if the rest state is shown.

    The first and last baked frames extend beyond the range; in between, shapes may be held.
    """
    if all(is_packed(item) for item in clay_objects(scene)):
        return scene.frame_current
    playback = playback_state.playback(scene)
    frames = playback.frames() if playback else []
    return _wanted(scene, frames) if frames else None


def show_rest(scene: bpy.types.Scene) -> None:
    """Show the clay's starting shape, as it was before the bake.

    Edits made to the points while they showed that shape (Apply Transform, Set Origin, Join, Edit
    Mode) become part of it.
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
    """Do not update the point clouds when the frame changes within the context."""
    playback_state.pause_count += 1
    try:
        yield
    finally:
        playback_state.pause_count -= 1


def _show(
    scene: bpy.types.Scene,
    clay: list[bpy.types.Object],
    depsgraph: bpy.types.Depsgraph | None,
) -> None:
    playback = playback_state.playback(scene)
    frames = playback.frames() if playback else []
    if playback is None or not frames:
        show_rest(scene)
        return
    if any(is_sculpted(item) for item in clay):
        show_rest(scene)
        raise CacheError("the clay was sculpted since it was baked. Bake again, or undo")
    try:
        meta = playback.meta()
    except CacheError as error:
        raise CacheError(f"{error}. Bake again") from error
    if not is_bake_of(meta, clay):
        show_rest(scene)
        names = ", ".join(f"{part.name} ({part.count:,} particles)" for part in meta.clay)
        raise CacheError(f"the bake is of different clay: {names}. Bake again")
    wanted = _wanted(scene, frames)
    if wanted not in frames:
        raise CacheMissingError("it is missing in the bake. Press Resume")
    try:
        positions = _positions(scene, playback, wanted)
        inverse = [local_from_world(item, depsgraph) for item in clay]
    except CacheDamagedError as error:
        raise CacheDamagedError(f"{error}. Press Resume to bake it again") from error
    except ValueError as error:
        raise CacheError(str(error)) from error
    for item, matrix, rows in zip(clay, inverse, positions, strict=True):
        write_points(item, transform(matrix, rows))
        if BAKED_MARK not in item.data:
            item.data[BAKED_MARK] = True


def _positions(
    scene: bpy.types.Scene, playback: Playback, wanted: int
) -> list[NDArray[np.float32]]:
    """World positions of each object at the current moment, which motion blur puts between frames.

    Two baked frames are mixed linearly, as packed playback does it; a held shape stays.
    """
    positions = playback.frame(wanted).positions
    moment = shown_moment(scene)
    fraction = np.float32(moment - math.floor(moment))
    following = wanted + 1
    if not fraction or scene.tactile_clay.hold_frames > 1 or math.floor(moment) != wanted:
        return positions
    if following not in playback.frames():
        return positions
    later_positions = playback.frame(following).positions
    return [a + (b - a) * fraction for a, b in zip(positions, later_positions, strict=True)]


def _wanted(scene: bpy.types.Scene, frames: list[int]) -> int:
    return baked_frame(frames, math.floor(shown_moment(scene)), hold=scene.tactile_clay.hold_frames)


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


@persistent
def _on_frame_change(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    refresh(scene, depsgraph)


@persistent
def _on_reload(*_: object) -> None:
    playback_state.forget()
    later.schedule(_show_all)


def _show_all() -> None:
    for scene in bpy.data.scenes:
        if clay_objects(scene):
            # After loading and Undo, the objects' world matrices are not up to date yet.
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
    """Add the handlers and listen for changed hold lengths."""
    add_handlers(_HANDLERS)
    held_frames_changed.connect(refresh)


def unregister() -> None:
    """Remove the handlers and forget all state."""
    held_frames_changed.disconnect(refresh)
    remove_handlers(_HANDLERS)
    playback_state.forget()
