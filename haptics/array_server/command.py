# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line of the array server: ``tactile-clay array-server DEVICE`` and ``--list``."""

from __future__ import annotations

import argparse
import importlib
import json
import os
import secrets
import signal
import sys
import threading
from collections.abc import Sequence

from ..devices import DEVICE_KINDS, DeviceError, FoundDevice, make_device
from .client import DEFAULT_PORT
from .guard import Guard
from .limits import Limits
from .server import ArrayServer

_EXIT_DONE, _EXIT_FAILED, _EXIT_USAGE = 0, 1, 2

_DEVICES = """\
devices:
  simulated[:PRESET]            a simulated array
  sonicsurface[:PORT]           options: firmware=stock|tactile, boards=1|2
  ultraino[:PORT]               options: board=mega|fpga|fpga128, boards=N, array=NAME|FILE.toml
  openmpd:BOARD.pat             the board file of its driver
  autd3[:ADDRESS]               an Ethernet interface, or HOST:PORT of its emulator
  stratos_explore:BRIDGE        the bridge program, built against your SDK; option: full=PA
options follow the address after commas: sonicsurface:/dev/ttyUSB0,firmware=tactile

There is sound only while focal points arrive that are recent (150 ms) and inside the array's
working volume. Caps limit them, and can only be lowered. Only programs on this machine can reach
the server.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments to a parser."""
    limits = Limits()
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = "\n".join(filter(None, (_DEVICES, parser.epilog)))
    parser.add_argument("device", metavar="DEVICE", nargs="?", help="the array, see below")
    parser.add_argument("--list", action="store_true", help="list connected devices and exit")
    parser.add_argument(
        "--port",
        type=int,
        default=DEFAULT_PORT,
        metavar="N",
        help=f"port on 127.0.0.1 to listen on (default: {DEFAULT_PORT}; 0 for any free port)",
    )
    parser.add_argument(
        "--amplitude-cap",
        type=float,
        default=limits.amplitude,
        metavar="A",
        help="maximum drive amplitude, 0 to 1 (default: %(default)g)",
    )
    parser.add_argument(
        "--pressure-cap",
        type=float,
        default=limits.pressure,
        metavar="PA",
        help="maximum pressure at a focal point [Pa] (default and upper limit: %(default)g)",
    )
    parser.add_argument(
        "--on-time",
        type=float,
        default=limits.on_time,
        metavar="S",
        help="maximum time of sound without a pause [s] (default and upper limit: %(default)g)",
    )
    parser.add_argument(
        "--for-client",
        action="store_true",
        help="listen only to the program that started this, and end with it",
    )


def list_devices() -> tuple[list[FoundDevice], list[str]]:
    """Connected devices, and problems that prevented the search for some kinds."""
    found, problems = [], []
    for kind in DEVICE_KINDS:
        module = importlib.import_module(f"..devices.{kind}", __package__)
        if hasattr(module, "list_devices"):
            try:
                found += module.list_devices()
            except DeviceError as error:
                problems.append(str(error))
    return found, list(dict.fromkeys(problems))


def carry_out(arguments: argparse.Namespace) -> int:
    """Run the command with parsed arguments.

    Returns:
        The exit code: 0 success, 1 failure, 2 wrong usage.
    """
    if arguments.list:
        found, problems = list_devices()
        for device in found:
            print(f"{device.name:<40}  {device.description}")
        for problem in problems:
            print(f"array-server: {problem}", file=sys.stderr)
        if not found:
            print("No device that could be an array is connected.", file=sys.stderr)
        return _EXIT_DONE
    if not arguments.device:
        print("array-server: give a device or --list", file=sys.stderr)
        return _EXIT_USAGE
    return _serve(arguments)


def _serve(arguments: argparse.Namespace) -> int:
    try:
        limits = Limits(arguments.amplitude_cap, arguments.pressure_cap, arguments.on_time)
        device = make_device(arguments.device)
    except (DeviceError, ValueError) as error:
        return _fail(str(error), arguments, _EXIT_USAGE)
    guard = None if device.has_watchdog else Guard(arguments.device)
    session = secrets.randbelow(2**32 - 1) + 1 if arguments.for_client else 0
    try:
        server = ArrayServer(
            device,
            name=arguments.device,
            limits=limits,
            port=0 if arguments.for_client else arguments.port,
            session=session,
            guard=guard,
        )
    except OSError as error:
        if guard is not None:
            guard.end(silent=True)
        return _fail(
            f"cannot listen on port {arguments.port} ({error.strerror}). Another array server may "
            "be running; choose another port with --port",
            arguments,
            _EXIT_FAILED,
        )
    _end_on_signals(server)
    if arguments.for_client:
        _end_with_standard_input(server)
        print(json.dumps({"port": server.port, "session": session}), flush=True)
    else:
        print(f"{arguments.device}: listening on 127.0.0.1:{server.port}", flush=True)
    server.run()
    if server.emitting:
        print(
            f"array-server: {arguments.device} could not be silenced ({server.fault}) and may "
            "still be emitting. Switch off its power.",
            file=sys.stderr,
        )
        return _EXIT_FAILED
    return _EXIT_DONE


def _fail(message: str, arguments: argparse.Namespace, code: int) -> int:
    # A client that starts a server reads the first line of its output.
    print(f"array-server: {message}", file=sys.stdout if arguments.for_client else sys.stderr)
    return code


def _end_on_signals(server: ArrayServer) -> None:
    def stop(number: int, frame: object) -> None:
        server.stopping = True

    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), stop)


def _end_with_standard_input(server: ArrayServer) -> None:
    def wait() -> None:
        while os.read(0, 4096):
            pass
        server.stopping = True

    threading.Thread(target=wait, daemon=True).start()


def main(argv: Sequence[str]) -> int:
    """Run the command with the arguments that follow its name; return the exit code."""
    parser = argparse.ArgumentParser(
        prog="array-server", description="Drive an ultrasound array with focal points."
    )
    add_arguments(parser)
    try:
        arguments = parser.parse_args(list(argv))
    except SystemExit as end:
        return int(end.code or 0)
    return carry_out(arguments)
