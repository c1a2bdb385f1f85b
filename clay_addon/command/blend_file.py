# SPDX-License-Identifier: GPL-3.0-or-later
"""The .blend file a command works on: opening it, the paths given with it, saving it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ...solver.core.errors import TactileClayError
from .words import EXIT_FAILED, EXIT_USAGE


class CommandError(TactileClayError):
    """The command cannot be carried out."""

    def __init__(self, message: str, exit_code: int = EXIT_FAILED) -> None:
        super().__init__(message)
        self.exit_code = exit_code


def need_bpy() -> Any:
    """The bpy module.

    Raises:
        CommandError: It is not installed.
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
    """Open the file and find the scene that a command names.

    Returns:
        The context and the scene.

    Raises:
        CommandError: There is no such file or scene, or the file cannot be opened.
    """
    bpy = need_bpy()
    if arguments.file is not None:
        path = arguments.file.absolute()
        if not path.is_file():
            raise CommandError(f"There is no file {path}.", EXIT_USAGE)
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
        known = ", ".join(each.name for each in bpy.data.scenes)
        raise CommandError(
            f"There is no scene {arguments.scene!r}. There are: {known}.", EXIT_USAGE
        )
    if context.window is not None:
        context.window.scene = scene
    return context, scene


def absolute_path(path: str | None) -> str | None:
    """A path given in the shell is relative to the shell; ``//`` to the .blend."""
    if path is None or path.startswith("//"):
        return path
    return str(Path(path).absolute())


def save_file(what: str) -> None:
    """Save the open .blend after a command, named by what it did.

    Raises:
        CommandError: The file has no name or cannot be written.
    """
    import bpy

    if not bpy.data.filepath:
        raise CommandError(f"The {what} is done, but the .blend has no name to be saved under.")
    try:
        bpy.ops.wm.save_mainfile()
    except RuntimeError as error:
        raise CommandError(
            f"The {what} is done, but the .blend cannot be saved: {error}"
        ) from error
