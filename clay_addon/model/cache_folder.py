# SPDX-License-Identifier: GPL-3.0-or-later
"""The folder of a scene's bake, and whose it is."""

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
        scene: Its cache folder is taken where `directory` is None.
        directory: A path; one that starts with ``//`` is beside the .blend.

    Raises:
        CacheFolderError: No folder is set, or it is relative to a .blend that was never saved,
            or to nothing at all.
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
            f"The cache folder {text!r} is beside nothing known. Begin it with // for a folder "
            "beside the .blend, or give the whole path."
        )
    return path.absolute()


def owner_of(scene: bpy.types.Scene, cache: Cache) -> str:
    """The .blend, seen from the cache folder so that both can move together, and the scene."""
    if not bpy.data.filepath:
        return ""
    try:
        blend = os.path.relpath(bpy.data.filepath, cache.directory)
    except ValueError:
        blend = bpy.data.filepath
    return f"{Path(blend).as_posix()}|{scene.name}"
