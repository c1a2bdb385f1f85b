# SPDX-License-Identifier: GPL-3.0-or-later
"""Autosave of a live session, so that a crash costs only a few seconds of work.

Blender does not autosave while a modal operator like Sculpt runs, so the session does: after each
stroke, and every few seconds while the clay moves. The file is beside the .blend and is removed
when the session ends or the .blend is saved. If one exists when a .blend is opened, the session was
interrupted, and its clay is recovered.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import IO
from zipfile import BadZipFile

import bpy
import numpy as np
from bpy.app.handlers import persistent
from numpy.typing import NDArray

from ...base.app_handlers import add_handlers, remove_handlers
from ...base.later import later
from ...core.storage.atomic_files import replace_file
from ...model.clay_points import keep_sculpted, replace_points
from ...model.clay_scene import clay_colors, clay_objects, read_points

_SUFFIX = ".clay-autosave.npz"
_INTERVAL = 5.0
"""Time between saves while the clay moves [s]."""
_VERSION = 1
_NEVER_SAVED = "Save the .blend: until it has been saved once, a crash loses the clay."


class Recovery:
    """The recovery, if any, when the current file was opened."""

    def __init__(self) -> None:
        self.message = ""
        """What was recovered, or why that failed, as a sentence; empty if there was no autosave."""


recovery = Recovery()


def autosave_path(blend: str) -> Path | None:
    """The autosave file of a .blend; None if the .blend was never saved."""
    return Path(f"{blend}{_SUFFIX}") if blend else None


class Autosave:
    """Saves a session's clay on its own thread."""

    def __init__(self) -> None:
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="clay-autosave")
        self._writing: Future[None] | None = None
        self._last: float | None = None
        self._paths: set[Path] = set()
        self.problem = ""
        """Why the last save failed; empty if it succeeded."""

    def save_if_due(self, scene: bpy.types.Scene, now: float) -> None:
        """Save if the interval since the last save is over.

        Args:
            scene: The session's scene.
            now: Time of a monotonic clock [s].
        """
        if self._last is None or now - self._last >= _INTERVAL:
            self._last = now
            self.begin(scene)

    def begin(self, scene: bpy.types.Scene) -> None:
        """Start saving the clay as displayed, unless the last save is still running."""
        path = autosave_path(bpy.data.filepath)
        if path is None:
            self.problem = _NEVER_SAVED
            return
        if self.problem == _NEVER_SAVED:
            self.problem = ""
        if self._writing is not None and not self._writing.done():
            return
        if self._writing is not None:
            error = self._writing.exception()
            self.problem = f"The clay could not be autosaved: {error}." if error else ""
        arrays = _arrays_of(scene)
        self._paths.add(path)
        self._writing = self._executor.submit(_write, path, arrays)

    def close(self) -> None:
        """End the thread, and remove the file, as Blender has the clay."""
        self._executor.shutdown(wait=True)
        for path in self._paths:
            with suppress(OSError):
                path.unlink(missing_ok=True)

    def forget(self) -> None:
        """Remove the file after the .blend was saved, as it contains nothing newer."""
        if self._writing is not None:
            self._writing.exception()
        for path in self._paths:
            with suppress(OSError):
                path.unlink(missing_ok=True)


def _arrays_of(scene: bpy.types.Scene) -> dict[str, NDArray]:
    clay = clay_objects(scene)
    arrays: dict[str, NDArray] = {
        "version": np.array(_VERSION),
        "scene": np.array(scene.name),
        "names": np.array([item.name for item in clay]),
    }
    for number, item in enumerate(clay):
        local = read_points(item, "position")
        if local is not None:
            arrays[f"positions_{number}"] = local
            arrays[f"colors_{number}"] = clay_colors(item)
    return arrays


def _write(path: Path, arrays: dict[str, NDArray]) -> None:
    def save(file: IO[bytes]) -> None:
        np.savez(file, allow_pickle=False, **arrays)

    replace_file(path, path.with_name(path.name + ".part"), save)


def recover(context: bpy.types.Context, path: Path) -> list[str]:
    """Restore the clay of the current file from an autosave.

    Args:
        context: The context of the current file.
        path: The autosave file.

    Returns:
        Names of the recovered objects.

    Raises:
        ValueError: The file is not an autosave, or is damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        names = [str(name) for name in arrays["names"]]
        scene_name = str(arrays["scene"])
        if int(arrays["version"]) != _VERSION:
            raise ValueError(f"it has the unknown version {int(arrays['version'])}")
    except (OSError, KeyError, ValueError, EOFError, BadZipFile) as error:
        raise ValueError(f"{path.name} cannot be read: {error}") from error
    scene = bpy.data.scenes.get(scene_name)
    recovered = []
    for number, name in enumerate(names):
        item = scene.objects.get(name) if scene else None
        local, colors = arrays.get(f"positions_{number}"), arrays.get(f"colors_{number}")
        if item is None or item.type != "POINTCLOUD" or local is None or colors is None:
            continue
        if local.shape != (len(colors), 3) or not len(local) or not np.isfinite(local).all():
            raise ValueError(f"{path.name} is damaged at {name!r}")
        replace_points(context, item, local, colors)
        keep_sculpted(item)
        recovered.append(name)
    return recovered


@persistent
def _on_load(*_: object) -> None:
    later.schedule(_recover_beside_file)


def _recover_beside_file() -> None:
    """Recover the clay of an interrupted session from the autosave beside the opened file."""
    recovery.message = ""
    path = autosave_path(bpy.data.filepath)
    if path is None or not path.is_file():
        return
    with suppress(OSError):
        if path.stat().st_mtime < Path(bpy.data.filepath).stat().st_mtime:
            # The .blend is newer.
            path.unlink()
            return
    try:
        recovered = recover(bpy.context, path)
    except ValueError as error:
        recovery.message = f"The autosaved clay could not be recovered: {error}."
        return
    if recovered:
        recovery.message = (
            f"The last session was interrupted. {', '.join(recovered)} was recovered from its "
            "autosave. Save the file to keep it."
        )


def register() -> None:
    """Check for an autosave whenever a file is opened."""
    add_handlers((("load_post", _on_load),))


def unregister() -> None:
    """Remove the handler."""
    remove_handlers((("load_post", _on_load),))
