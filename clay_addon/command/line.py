# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line: bake, render, deliver, export and inspect .blend files, and track hands.

The same commands work as ``tactile-clay bake FILE.blend`` (with the bpy module) and as
``blender -b FILE.blend -c clay bake`` (inside Blender, for the open file).
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Sequence
from typing import Any

from .bake_command import bake_command
from .blend_file import CommandError, require_bpy
from .deliver_command import deliver_command
from .export_command import export_command
from .info_command import info_command
from .output import stdout_to_stderr
from .parser import (
    EXIT_DONE,
    EXIT_INTERRUPTED,
    Outcome,
    joined_ranges,
    make_parser,
)
from .render_command import render_command


def main(argv: Sequence[str]) -> int:
    """Run a command on the .blend file it names.

    Args:
        argv: The arguments after the program name.

    Returns:
        The exit code: 0 done, 1 failed, 2 usage, 3 stale, 130 interrupted.
    """
    return _main(argv, program="tactile-clay", file_argument=True)


def main_in_blender(argv: Sequence[str]) -> int:
    """Run a command on the file open in Blender; see `main`."""
    return _main(argv, program="blender -b FILE.blend -c clay", file_argument=False)


def run() -> None:
    """Run the command from the shell, and end the process."""
    try:
        code = main(sys.argv[1:])
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader closed the output, as `head` does.
        code = 0
    sys.stderr.flush()
    # The bpy module of Blender 4.5 can hang while the interpreter shuts down.
    os._exit(code)


def _main(argv: Sequence[str], *, program: str, file_argument: bool) -> int:
    parser = make_parser(program, file_argument=file_argument, commands=COMMANDS)
    try:
        arguments = parser.parse_args(joined_ranges(argv))
    except SystemExit as end:
        return int(end.code or 0)
    try:
        # Output of Blender and Warp goes to standard error, so that standard output contains only
        # the result.
        with contextlib.nullcontext() if _prints_itself(arguments) else stdout_to_stderr():
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
    """Whether a command prints its own output while running."""
    return arguments.carry_out in (_demo, _array_server)


def _array_server(arguments: argparse.Namespace) -> Outcome:
    from ...haptics.array_server.command import carry_out

    return carry_out(arguments), ""


def _demo(arguments: argparse.Namespace) -> Outcome:
    require_bpy()
    from . import demo

    argv = ["--scene", arguments.scene]
    if arguments.output is not None:
        argv += ["--output", str(arguments.output)]
    return demo.main(argv), ""


def _track(arguments: argparse.Namespace) -> Outcome:
    # This command runs without Blender.
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
"""Functions that run the commands, by name."""


class _BlenderCommand:
    """Registration of ``blender -c clay``."""

    def __init__(self) -> None:
        self._handle: Any = None

    def register(self) -> None:
        """Register ``blender -c clay``."""
        import bpy

        self._handle = bpy.utils.register_cli_command("clay", main_in_blender)

    def unregister(self) -> None:
        """Unregister ``blender -c clay``, if it is registered."""
        import bpy

        if self._handle is not None:
            bpy.utils.unregister_cli_command(self._handle)
            self._handle = None


_blender_command = _BlenderCommand()
register = _blender_command.register
unregister = _blender_command.unregister
