# SPDX-License-Identifier: GPL-3.0-or-later
"""The cache folder of a scene's bake, and the owner recorded in it."""

from __future__ import annotations

import os
from pathlib import Path

import bpy

from ...solver.core.errors import TactileClayError
from ..core.storage.cache import Cache


class CacheFolderError(TactileClayError):
    """A scene has no usable cache folder; the message says why and what to do."""


def resolve_directory(
    scene: bpy.types.Scene, directory: str | os.PathLike[str] | None = None
) -> Path:
    """The cache folder as an absolute path.

    Args:
        scene: The scene whose cache folder is used if `directory` is None.
        directory: A path; ``//`` at its start is the folder of the .blend file.

    Raises:
        CacheFolderError: No folder is set, it is relative to a .blend that was never saved, or
            the scene's folder is a relative path without ``//``.
    """
    text = os.fspath(directory) if directory is not None else scene.tactile_clay.cache_directory
    if not text:
        raise CacheFolderError("No cache folder is set. Set one in the Bake panel.")
    if text.startswith("//") and not bpy.data.filepath:
        raise CacheFolderError(
            "The .blend was never saved, and its bake goes into a folder beside it. Save the file "
            "first, or set an absolute cache folder."
        )
    path = Path(bpy.path.abspath(text))
    if directory is None and not path.is_absolute():
        raise CacheFolderError(
            f"The cache folder {text!r} is relative to nothing. Begin it with // for a folder "
            "beside the .blend, or give an absolute path."
        )
    return path.absolute()


def owner_of(scene: bpy.types.Scene, cache: Cache) -> str:
    """The owner of a cache: the .blend's path and the scene's name; empty if never saved.

    The path is relative to the cache folder, so that both can be moved together.
    """
    if not bpy.data.filepath:
        return ""
    try:
        blend = os.path.relpath(bpy.data.filepath, cache.directory)
    except ValueError:
        blend = bpy.data.filepath
    return f"{Path(blend).as_posix()}|{scene.name}"
