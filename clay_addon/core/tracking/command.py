# SPDX-License-Identifier: GPL-3.0-or-later
"""``tactile-clay track SOURCE``: runs a tracker's sender as a separate process."""

from __future__ import annotations

import _thread
import argparse
import contextlib
import math
import sys
import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TextIO

from .protocol.packet import PORT
from .recording.recording import Recorder, read_recording
from .sources.sender import Sender, Sighting, replay, run

_DESCRIPTION = """\
Track hands and send them to Blender.

Start Tracking in Blender's Clay tab, then run one of the sources below in a terminal. It runs
until Ctrl-C. Hands are sent to loopback only, 864 bytes each. The format is documented in
clay_addon/core/tracking/protocol/packet.py, so that other programs can send hands too.
"""

_OpenSource = Callable[[argparse.Namespace], Iterable[Sighting]]


def add_command(commands: Any, *, carry_out: Callable[[argparse.Namespace], object]) -> None:
    """Add ``track`` to a parser's commands.

    Args:
        commands: The result of the parser's `add_subparsers`.
        carry_out: Stored as ``carry_out`` in the parsed arguments.
    """
    command = commands.add_parser(
        "track",
        help="track hands and send them to Blender",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    sources = command.add_subparsers(title="sources", metavar="SOURCE", required=True)

    def add(name: str, text: str, open_source: _OpenSource) -> argparse.ArgumentParser:
        source: argparse.ArgumentParser = sources.add_parser(
            name, help=text, description=text[0].upper() + text[1:] + "."
        )
        source.set_defaults(carry_out=carry_out, open_source=open_source, file=None, setup=False)
        source.add_argument(
            "--port", type=_port, default=PORT, help=f"Blender's tracking port (default: {PORT})"
        )
        source.add_argument(
            "--record", type=Path, metavar="FILE.jsonl", help="also record what is sent"
        )
        source.add_argument(
            "--duration", type=_positive, metavar="SECONDS", help="stop after this time"
        )
        source.add_argument(
            "--attached", action="store_true", help="stop when standard input is closed"
        )
        return source

    def add_pace(source: argparse.ArgumentParser) -> None:
        source.add_argument(
            "--speed",
            type=_speed,
            default=1.0,
            metavar="FACTOR",
            help="playback speed; 0 plays as fast as possible (default: 1)",
        )
        source.add_argument("--loop", action="store_true", help="play it repeatedly")

    recording = add("recording", "play a recording of hands", _recording)
    recording.add_argument("file", metavar="FILE.jsonl", type=Path)
    add_pace(recording)
    leap = add("leap", "a LeapJS recording, or the Leap service's websocket", _leap)
    leap.add_argument(
        "file",
        metavar="FILE.json",
        type=Path,
        nargs="?",
        help="a LeapJS Playback recording, .json or .json.gz (default: the service)",
    )
    leap.add_argument("--address", metavar="URL", help="address of the service's websocket")
    add_pace(leap)
    mediapipe = add("mediapipe", "a webcam, a video or images, through MediaPipe", _mediapipe)
    mediapipe.add_argument(
        "inputs", nargs="*", metavar="FILE", help="a video or images (default: a camera)"
    )
    mediapipe.add_argument("--camera", type=int, default=0, help="camera index (default: 0)")
    mediapipe.add_argument(
        "--setup", action="store_true", help="install MediaPipe in its own environment (650 MB)"
    )
    mediapipe.add_argument(
        "--environment",
        type=Path,
        metavar="DIR",
        help="folder of that environment (default: in the user's application data)",
    )
    mediapipe.add_argument(
        "--field-of-view",
        type=_angle,
        default=65.0,
        metavar="DEGREES",
        help="horizontal field of view of the camera (default: 65)",
    )
    mediapipe.add_argument(
        "--mirrored", action="store_true", help="the camera's images are mirrored"
    )
    hts = add("hts", "Hand Tracking Streamer on a Meta Quest, over UDP", _hts)
    hts.add_argument(
        "--listen",
        type=_listen,
        default=("0.0.0.0", 9000),
        metavar="[HOST:]PORT",
        help="address the app sends to (default: every address of this machine, port 9000)",
    )
    add("openxr", "the machine's OpenXR runtime, through pyopenxr", _openxr)
    leapc = add("leapc", "an Ultraleap device, through the LeapC library", _leapc)
    leapc.add_argument("--library", metavar="PATH", help="the LeapC library, if it is not found")


def track(arguments: argparse.Namespace) -> str:
    """Run the command.

    Returns:
        The message to print at the end.

    Raises:
        TrackingError: The command failed; the message says why and what to do.
    """
    if arguments.setup:
        from .sources.mediapipe_setup import default_environment, set_up

        set_up(arguments.environment or default_environment(), report=_report)
        return ""
    source = arguments.open_source(arguments)
    if arguments.attached:
        threading.Thread(target=_wait_for_end, args=(sys.stdin,), daemon=True).start()
    recorder = Recorder(arguments.record) if arguments.record else None
    sender = Sender(arguments.port)
    _report(f"Sending hands to port {arguments.port} of this machine. Press Ctrl-C to stop.")
    try:
        with contextlib.suppress(KeyboardInterrupt):
            run(source, sender, recorder=recorder, duration=arguments.duration)
    finally:
        sender.close()
        written = recorder.close() if recorder else None
    text = f"{sender.sent} datagrams sent."
    if recorder is not None:
        text += f" Recording: {written}." if written else " Nothing was recorded."
    return text


def _wait_for_end(stream: TextIO) -> None:
    """Interrupt the program when a stream ends: the parent process has exited or closed it."""
    with contextlib.suppress(OSError, ValueError):
        while stream.read(1):
            pass
    _thread.interrupt_main()


def _report(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


# The sources ------------------------------------------------------------------------------------


def _recording(arguments: argparse.Namespace) -> Iterable[Sighting]:
    return replay(read_recording(arguments.file), speed=arguments.speed, loop=arguments.loop)


def _leap(arguments: argparse.Namespace) -> Iterable[Sighting]:
    if arguments.file is not None:
        return _recording(arguments)
    from .sources.leap import ADDRESS, leap_service

    return leap_service(arguments.address or ADDRESS)


def _mediapipe(arguments: argparse.Namespace) -> Iterable[Sighting]:
    from .formats.mediapipe import MediapipeHands
    from .sources.camera import mediapipe
    from .sources.mediapipe_setup import default_environment

    hands = MediapipeHands(field_of_view=arguments.field_of_view, mirrored=arguments.mirrored)
    inputs = arguments.inputs or [str(arguments.camera)]
    return mediapipe(inputs, arguments.environment or default_environment(), hands)


def _hts(arguments: argparse.Namespace) -> Iterable[Sighting]:
    from .sources.hts import hts_stream

    return hts_stream(*arguments.listen)


def _openxr(arguments: argparse.Namespace) -> Iterable[Sighting]:
    from .sources.openxr import openxr

    return openxr()


def _leapc(arguments: argparse.Namespace) -> Iterable[Sighting]:
    from .sources.leapc import leapc

    return leapc(arguments.library)


# Option types -----------------------------------------------------------------------------------


def _port(text: str) -> int:
    with contextlib.suppress(ValueError):
        if 0 < int(text) < 65536:
            return int(text)
    raise argparse.ArgumentTypeError(f"{text!r} is not a port number from 1 to 65535")


def _number(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number")
    return number


def _positive(text: str) -> float:
    number = _number(text)
    if number <= 0.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not greater than 0")
    return number


def _speed(text: str) -> float:
    number = _number(text)
    if number < 0.0:
        raise argparse.ArgumentTypeError(f"{text!r} is less than 0")
    return number


def _angle(text: str) -> float:
    number = _number(text)
    if not 10.0 <= number <= 170.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not between 10 and 170 degrees")
    return number


def _listen(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    return host or "0.0.0.0", _port(port)
