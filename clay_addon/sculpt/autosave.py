# SPDX-License-Identifier: GPL-3.0-or-later
"""The clay of a live session on disk, so that a crash takes little of it.

Blender does not save by itself while an operator like Sculpt runs, so the session does: after each
stroke, and every few seconds in which the clay moves. The file stands beside the .blend, and goes
when the session ends or the .blend is saved. Where one is found when a .blend is opened, the
session was cut short, and its clay is taken up.
"""

from __future__ import annotations

import os
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from zipfile import BadZipFile

import bpy
import numpy as np
from bpy.app.handlers import persistent
from numpy.typing import NDArray

from ..base.app_handlers import add_handlers, remove_handlers
from ..model.clay_points import keep_sculpted, replace_points
from ..model.clay_scene import clay_colors, clay_objects, read_points

_SUFFIX = ".clay-autosave.npz"
_EVERY = 5.0
"""While the clay moves, it is saved this often [s]."""
_VERSION = 1
_NEVER_SAVED = "Save the .blend once: until then a crash would take the clay with it."

message = ""
"""What was taken up when the file was opened, as a sentence; empty where nothing was."""


def autosave_path(blend: str) -> Path | None:
    """Where the clay of a .blend is saved to by itself; None for one that was never saved."""
    return Path(f"{blend}{_SUFFIX}") if blend else None


class Autosave:
    """Saves a session's clay by itself, on a thread of its own."""

    def __init__(self) -> None:
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="clay-autosave")
        self._writing: Future[None] | None = None
        self._last: float | None = None
        self._paths: set[Path] = set()
        self.problem = ""
        """Why it could not be saved last; empty where it could."""

    def now_and_then(self, scene: bpy.types.Scene, now: float) -> None:
        """Save if that was not done for a while.

        Args:
            scene: The session's.
            now: Seconds of a steady clock.
        """
        if self._last is None or now - self._last >= _EVERY:
            self._last = now
            self.begin(scene)

    def begin(self, scene: bpy.types.Scene) -> None:
        """Begin to save what is shown, unless the last time is still going on."""
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
            self.problem = f"The clay could not be saved by itself: {error}." if error else ""
        arrays = _arrays_of(scene)
        self._paths.add(path)
        self._writing = self._executor.submit(_write, path, arrays)

    def close(self) -> None:
        """End it, and remove the file: what it holds is in Blender."""
        self._executor.shutdown(wait=True)
        for path in self._paths:
            with suppress(OSError):
                path.unlink(missing_ok=True)

    def forget(self) -> None:
        """The .blend itself was saved: until clay moves again, there is nothing beyond it."""
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
    part = path.with_name(path.name + ".part")
    with part.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)


def take_up(context: bpy.types.Context, path: Path) -> list[str]:
    """Give the clay of the open file the shape that a session saved by itself.

    Args:
        context: Its scenes hold the clay.
        path: The file that the session left.

    Returns:
        Names of the objects that took it up.

    Raises:
        ValueError: It is not such a file, or it is damaged; the clay stays as it was.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        names = [str(name) for name in arrays["names"]]
        scene_name = str(arrays["scene"])
        if int(arrays["version"]) != _VERSION:
            raise ValueError(f"it is of version {int(arrays['version'])}")
    except (OSError, KeyError, ValueError, EOFError, BadZipFile) as error:
        raise ValueError(f"{path.name} cannot be read: {error}") from error
    scene = bpy.data.scenes.get(scene_name)
    taken = []
    for number, name in enumerate(names):
        item = scene.objects.get(name) if scene else None
        local, colors = arrays.get(f"positions_{number}"), arrays.get(f"colors_{number}")
        if item is None or item.type != "POINTCLOUD" or local is None or colors is None:
            continue
        if local.shape != (len(colors), 3) or not len(local) or not np.isfinite(local).all():
            raise ValueError(f"{path.name} is damaged at {name!r}")
        replace_points(context, item, local, colors)
        keep_sculpted(item)
        taken.append(name)
    return taken


@persistent
def _on_load(*_: object) -> None:
    """Take up what a session that was cut short has left beside the file that was opened."""
    global message
    message = ""
    path = autosave_path(bpy.data.filepath)
    if path is None or not path.is_file():
        return
    with suppress(OSError):
        if path.stat().st_mtime < Path(bpy.data.filepath).stat().st_mtime:
            # The file was saved after it.
            path.unlink()
            return
    try:
        taken = take_up(bpy.context, path)
    except ValueError as error:
        message = f"Clay that a session saved by itself could not be taken up: {error}."
        return
    if taken:
        message = (
            f"The last session was cut short. {', '.join(taken)} is as it was saved by itself "
            "then; save the file to keep that."
        )


def register() -> None:
    """Look for what was left whenever a file is opened."""
    add_handlers((("load_post", _on_load),))


def unregister() -> None:
    """Look no more."""
    remove_handlers((("load_post", _on_load),))
