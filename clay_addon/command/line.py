# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line: bake, render, deliver, export and look into .blend files, and track hands.

The same words serve ``tactile-clay bake FILE.blend`` (with the bpy module) and
``blender -b FILE.blend -c clay bake`` (inside Blender, on the file that is open).
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Sequence
from typing import Any

from .bake_command import bake_command
from .blend_file import CommandError, need_bpy
from .deliver_command import deliver_command
from .export_command import export_command
from .info_command import info_command
from .output import diverted_output
from .render_command import render_command
from .words import (
    EXIT_DONE,
    EXIT_INTERRUPTED,
    Outcome,
    joined_ranges,
    make_parser,
)


def main(argv: Sequence[str]) -> int:
    """Carry out a command on a .blend file that it names.

    Args:
        argv: The words after the program's name.

    Returns:
        The exit code: 0 done, 1 failed, 2 usage, 3 stale, 130 interrupted.
    """
    return _main(argv, program="tactile-clay", names_file=True)


def main_in_blender(argv: Sequence[str]) -> int:
    """Carry out a command on the file that is open in Blender; see `main`."""
    return _main(argv, program="blender -b FILE.blend -c clay", names_file=False)


def run() -> None:
    """Carry out the command that the shell gave, and end the process."""
    try:
        code = main(sys.argv[1:])
        sys.stdout.flush()
    except BrokenPipeError:
        # Whoever read the output has seen enough, as `head` does.
        code = 0
    sys.stderr.flush()
    # The bpy module of Blender 4.5 can hang while the interpreter is torn down.
    os._exit(code)


def _main(argv: Sequence[str], *, program: str, names_file: bool) -> int:
    parser = make_parser(program, names_file=names_file, commands=COMMANDS)
    try:
        arguments = parser.parse_args(joined_ranges(argv))
    except SystemExit as end:
        return int(end.code or 0)
    try:
        # What Blender and Warp print belongs to the standard error: the standard output has the
        # result and nothing else.
        with contextlib.nullcontext() if _prints_itself(arguments) else diverted_output():
            code, result = arguments.carry_out(arguments)
        if result:
            print(result, flush=True)
        return code
    except CommandError as error:
        print(f"{program}: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print(f"{program}: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED


def _prints_itself(arguments: argparse.Namespace) -> bool:
    """Whether a command says on its own what it does, while it does it."""
    return arguments.carry_out in (_demo, _array_server)


def _array_server(arguments: argparse.Namespace) -> Outcome:
    from ...haptics.array_server.command import carry_out

    return carry_out(arguments), ""


def _demo(arguments: argparse.Namespace) -> Outcome:
    need_bpy()
    from . import demo

    words = ["--scene", arguments.scene]
    if arguments.output is not None:
        words += ["--output", str(arguments.output)]
    return demo.main(words), ""


def _track(arguments: argparse.Namespace) -> Outcome:
    # A tracker's sender runs without Blender.
    from ..core.tracking import TrackingError
    from ..core.tracking.command import track

    try:
        return EXIT_DONE, track(arguments)
    except TrackingError as error:
        raise CommandError(str(error)) from error


COMMANDS = {
    "bake": bake_command,
    "export": export_command,
    "deliver": deliver_command,
    "render": render_command,
    "info": info_command,
    "array-server": _array_server,
    "demo": _demo,
    "track": _track,
}
"""What carries each command out."""


class _BlenderCommand:
    """The entry for ``blender -c clay``, while the add-on is enabled."""

    def __init__(self) -> None:
        self._handle: Any = None

    def register(self) -> None:
        """Make ``blender -c clay`` known."""
        import bpy

        self._handle = bpy.utils.register_cli_command("clay", main_in_blender)

    def unregister(self) -> None:
        """Forget ``blender -c clay``; without it, do nothing."""
        import bpy

        if self._handle is not None:
            bpy.utils.unregister_cli_command(self._handle)
            self._handle = None


_blender_command = _BlenderCommand()
register = _blender_command.register
unregister = _blender_command.unregister
