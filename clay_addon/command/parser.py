# SPDX-License-Identifier: GPL-3.0-or-later
"""Parser of the command line: commands, options and exit codes."""

from __future__ import annotations

import argparse
import contextlib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..core.storage.playback import MAX_FRAME, NO_SUCH_FRAME
from ..core.tracking.command import add_command as add_track
from .demo_scenes import DEFAULT, SCENES

EXIT_DONE = 0
EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_STALE = 3
EXIT_INTERRUPTED = 130

Outcome = tuple[int, str]
"""Exit code, and the text for standard output."""
CarryOut = Callable[[argparse.Namespace], Outcome]
"""A function that runs a command."""

_EXIT_CODES = """\
exit codes:
  0    done
  1    failed; the message says why and what to do
  2    the command is invalid, or FILE.blend does not exist
  3    the bake is stale or incomplete: bake again, or resume
  130  interrupted; baked frames are kept, and --resume continues
"""


def make_parser(
    program: str, *, file_argument: bool, commands: Mapping[str, CarryOut]
) -> argparse.ArgumentParser:
    """Make the parser of all commands.

    Args:
        program: Name of the program for messages.
        file_argument: Whether the .blend is an argument; inside Blender it is the open file.
        commands: Functions that run the commands, by name.
    """

    def describe(text: str) -> dict[str, Any]:
        return {
            "help": text,
            "description": text[0].upper() + text[1:] + ".",
            "epilog": _EXIT_CODES,
            "formatter_class": argparse.RawDescriptionHelpFormatter,
        }

    parser = argparse.ArgumentParser(
        prog=program,
        description="Simulate, export and inspect the clay of .blend files.",
        epilog=_EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    words = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    def add(name: str, text: str) -> argparse.ArgumentParser:
        command = words.add_parser(name, **describe(text))
        command.set_defaults(carry_out=commands[name], file=None)
        return command

    def add_file_options(command: argparse.ArgumentParser) -> None:
        if file_argument:
            command.add_argument("file", metavar="FILE.blend", type=Path)
        command.add_argument(
            "--scene", metavar="NAME", help="the scene (default: the file's active one)"
        )
        command.add_argument(
            "--cache", metavar="DIR", help="the cache folder (default: the scene's)"
        )
        command.add_argument("--json", action="store_true", help="print the result as JSON")

    bake = add("bake", "simulate the clay into its cache")
    add_file_options(bake)
    bake.add_argument(
        "--frames",
        metavar="A-B",
        type=frame_range,
        help="frames to bake, as 1-120 or -10--1 (default: the scene's range)",
    )
    bake.add_argument(
        "--resume", action="store_true", help="keep existing frames and continue the bake"
    )
    bake.add_argument(
        "--device",
        choices=("auto", "cpu", "cuda:0"),
        help="device for the simulation (default: from the preferences)",
    )
    bake.add_argument(
        "--replace", action="store_true", help="overwrite the cache of another .blend or scene"
    )
    bake.add_argument(
        "--save", action="store_true", help="store --frames and --cache in the .blend, for playback"
    )

    bake.add_argument(
        "--again",
        action="store_true",
        help="bake the recorded take of the scene with finer clay, in a separate scene, and save "
        "the .blend; with --resume, continue that bake",
    )
    bake.add_argument(
        "--spacing",
        metavar="MM",
        type=_positive,
        help="with --again: particle spacing in millimeters (default: half the live spacing)",
    )
    bake.add_argument(
        "--substeps",
        metavar="N",
        type=int,
        default=0,
        help="with --again: solver steps per sixtieth of a second (default: chosen by the solver)",
    )

    export = add("export", "write the clay at a frame as one watertight mesh")
    add_file_options(export)
    export.add_argument(
        "--frame",
        type=frame_number,
        metavar="N",
        help="the frame (default: the file's current one)",
    )
    export.add_argument(
        "--output",
        type=Path,
        required=True,
        metavar="FILE",
        help="the file to write: .stl, .3mf, .obj, .ply or .glb",
    )
    export.add_argument(
        "--unit",
        choices=("auto", "m", "mm"),
        default="auto",
        help="unit of the numbers in the file (default: mm in .stl and .3mf, else m)",
    )
    export.add_argument(
        "--base", type=float, default=0.0, metavar="MM", help="height to cut off for a flat base"
    )
    export.add_argument(
        "--wall",
        type=float,
        default=1.0,
        metavar="MM",
        help="warn about thinner walls in .stl and .3mf (default: 1)",
    )

    deliver = add("deliver", "write the clay over time as USD or Alembic, with a player")
    add_file_options(deliver)
    deliver.add_argument(
        "--frames",
        metavar="A-B",
        type=frame_range,
        help="frames to write, as 1-120 or -10--1 (default: the scene's range, as far as it is "
        "baked)",
    )
    deliver.add_argument(
        "--format", choices=("usd", "abc"), help="usd or abc (default: the scene's, usd)"
    )
    deliver.add_argument("--points", action="store_true", help="also write the particles (usd)")
    deliver.add_argument(
        "--output", metavar="DIR", help="the folder of the delivery (default: the scene's)"
    )
    deliver.add_argument(
        "--save",
        action="store_true",
        help="play the files in place of the clay, and store that in the .blend",
    )

    render = add("render", "render baked frames to images")
    add_file_options(render)
    render.add_argument(
        "--frames",
        metavar="LIST",
        type=_frame_list,
        help="frames to render, as 1-120, -10--1 or 1-10,15,20 (default: the scene's range)",
    )
    render.add_argument(
        "--output",
        metavar="PATH",
        help="path of the images, such as images/frame_#### (default: the scene's)",
    )
    render.add_argument("--resume", action="store_true", help="keep existing images")

    info = add("info", "describe the clay in a file and its bake")
    add_file_options(info)

    if file_argument:
        from ...haptics.array_server.command import add_arguments as add_server_arguments

        server = add("array-server", "drive an ultrasound array with focal points")
        add_server_arguments(server)

    demo = add("demo", "simulate and render a scene of the gallery")
    demo.add_argument(
        "--scene",
        choices=list(SCENES),
        default=DEFAULT,
        help="; ".join(f"{name}: {scene.description}" for name, scene in SCENES.items()),
    )
    demo.add_argument("--output", type=Path, metavar="DIR", help="the output folder")
    add_track(words, carry_out=commands["track"])
    return parser


def _positive(text: str) -> float:
    value = float(text)
    if not (math.isfinite(value) and value > 0.0):
        raise argparse.ArgumentTypeError(f"{text!r} is not greater than 0")
    return value


def frame_number(text: str) -> int:
    """A frame number that Blender has.

    Raises:
        ValueError: It is no number.
        argparse.ArgumentTypeError: Blender would clamp it to another one.
    """
    number = int(text)
    if abs(number) > MAX_FRAME:
        raise argparse.ArgumentTypeError(NO_SUCH_FRAME.format(number))
    return number


def joined_ranges(words: Sequence[str]) -> list[str]:
    """Command-line words where a range of frames that begins with a minus belongs to its option.

    Argparse takes ``--frames -5--3`` for two options.
    """
    joined: list[str] = []
    for word in words:
        if joined and joined[-1] == "--frames" and re.match(r"-\d", word):
            joined[-1] = f"--frames={word}"
        else:
            joined.append(word)
    return joined


def frame_range(text: str) -> tuple[int, int]:
    """Parse a range such as ``1-120`` or, with negative frames, ``-10--1``.

    Raises:
        argparse.ArgumentTypeError: The text is not a range, or ends before it starts.
    """
    for split in range(1, len(text)):
        if text[split] == "-":
            with contextlib.suppress(ValueError):
                start, end = frame_number(text[:split]), frame_number(text[split + 1 :])
                if end < start:
                    raise argparse.ArgumentTypeError(f"{text!r} ends before it starts")
                return start, end
    raise argparse.ArgumentTypeError(f"{text!r} is not a range such as 1-120")


def _frame_list(text: str) -> list[int]:
    """Parse a list such as ``1-10,15`` to sorted, unique frame numbers."""
    frames: set[int] = set()
    for part in text.split(","):
        try:
            frames.add(frame_number(part))
        except ValueError:
            start, end = frame_range(part.strip())
            frames.update(range(start, end + 1))
    return sorted(frames)
