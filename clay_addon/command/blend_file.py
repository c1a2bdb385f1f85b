# SPDX-License-Identifier: GPL-3.0-or-later
"""The .blend file of a command: opening it, resolving paths, and saving it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ...solver.core.errors import TactileClayError
from .parser import EXIT_FAILED, EXIT_USAGE


class CommandError(TactileClayError):
    """A command failed; the message says why and what to do."""

    def __init__(self, message: str, exit_code: int = EXIT_FAILED) -> None:
        super().__init__(message)
        self.exit_code = exit_code


def require_bpy() -> Any:
    """Import the bpy module.

    Raises:
        CommandError: The module is not installed.
    """
    try:
        import bpy
    except ImportError as error:
        raise CommandError(
            "The bpy module is missing. Install it into this Python (the package bpy: 5.2 for "
            "Python 3.13, 4.5 for Python 3.11), or run the command inside Blender: "
            "blender -b FILE.blend -c clay …"
        ) from error
    return bpy


def open_scene(arguments: argparse.Namespace) -> tuple[Any, Any]:
    """Open the file and find the scene named in a command.

    Returns:
        The context and the scene.

    Raises:
        CommandError: The file or scene does not exist, or the file cannot be opened.
    """
    bpy = require_bpy()
    if arguments.file is not None:
        path = arguments.file.absolute()
        if not path.is_file():
            raise CommandError(f"{path} does not exist.", EXIT_USAGE)
        from .. import register

        register()
        try:
            bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
        except RuntimeError as error:
            raise CommandError(f"{path} cannot be opened: {error}", EXIT_USAGE) from error
    context = bpy.context
    if arguments.scene is None:
        return context, context.scene
    scene = bpy.data.scenes.get(arguments.scene)
    if scene is None:
        names = ", ".join(each.name for each in bpy.data.scenes)
        raise CommandError(
            f"There is no scene {arguments.scene!r}. The scenes are: {names}.", EXIT_USAGE
        )
    if context.window is not None:
        context.window.scene = scene
    return context, scene


def absolute_path(path: str | None) -> str | None:
    """Resolve a path relative to the working directory; keep ``//``, relative to the .blend."""
    if path is None or path.startswith("//"):
        return path
    return str(Path(path).absolute())


def save_file(what: str) -> None:
    """Save the open .blend after a command.

    Args:
        what: Name of the completed work, for messages.

    Raises:
        CommandError: The file was never saved, or cannot be written.
    """
    import bpy

    if not bpy.data.filepath:
        raise CommandError(f"The {what} is done, but the .blend has no file name to save to.")
    try:
        bpy.ops.wm.save_mainfile()
    except RuntimeError as error:
        raise CommandError(
            f"The {what} is done, but the .blend cannot be saved: {error}"
        ) from error
