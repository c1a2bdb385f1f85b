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
  simulated[:PRESET]            an array that is not there
  sonicsurface[:PORT]           options: firmware=stock|tactile, boards=1|2
  ultraino[:PORT]               options: board=mega|fpga|fpga128, boards=N, array=NAME|FILE.toml
  openmpd:BOARD.pat             the board's file, as its driver has it
  autd3[:ADDRESS]               an Ethernet interface, or HOST:PORT of its emulator
  stratos_explore:BRIDGE        the bridge program, built against your SDK; option: full=PA
options follow the address after commas: sonicsurface:/dev/ttyUSB0,firmware=tactile

Sound is off unless focal points come in that are fresh (150 ms), inside the array's working volume
and within the caps, which can only be lowered. Only programs on this machine can reach the server.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes to a parser."""
    limits = Limits()
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = "\n".join(filter(None, (_DEVICES, parser.epilog)))
    parser.add_argument("device", metavar="DEVICE", nargs="?", help="the array, see below")
    parser.add_argument("--list", action="store_true", help="list what is plugged in, and end")
    parser.add_argument(
        "--port",
        type=int,
        default=DEFAULT_PORT,
        metavar="N",
        help=f"port on 127.0.0.1 to listen on (default: {DEFAULT_PORT}; 0 for any)",
    )
    parser.add_argument(
        "--amplitude-cap",
        type=float,
        default=limits.amplitude,
        metavar="A",
        help="highest drive of a transducer, 0 to 1 (default: %(default)g)",
    )
    parser.add_argument(
        "--pressure-cap",
        type=float,
        default=limits.pressure,
        metavar="PA",
        help="highest pressure at a focal point [Pa] (default and most: %(default)g)",
    )
    parser.add_argument(
        "--on-time",
        type=float,
        default=limits.on_time,
        metavar="S",
        help="longest sound without a pause [s] (default and most: %(default)g)",
    )
    parser.add_argument(
        "--for-client",
        action="store_true",
        help="listen to the program that started this alone, and end with it",
    )


def list_devices() -> tuple[list[FoundDevice], list[str]]:
    """What is plugged in, and why some kinds could not be looked for."""
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
    """Do what parsed arguments ask for.

    Returns:
        The exit code: 0 done, 1 failed, 2 usage.
    """
    if arguments.list:
        found, problems = list_devices()
        for plugged in found:
            print(f"{plugged.name:<40}  {plugged.description}")
        for problem in problems:
            print(f"array-server: {problem}", file=sys.stderr)
        if not found:
            print("Nothing that could be an array is plugged in.", file=sys.stderr)
        return _EXIT_DONE
    if not arguments.device:
        print("array-server: name a device, or --list", file=sys.stderr)
        return _EXIT_USAGE
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
            f"port {arguments.port} cannot be listened on ({error.strerror}). Another array server "
            "may be running; --port chooses another port",
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
            "still sound. Switch its power off.",
            file=sys.stderr,
        )
        return _EXIT_FAILED
    return _EXIT_DONE


def _fail(message: str, arguments: argparse.Namespace, code: int) -> int:
    # A client that starts a server reads its first line.
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
    """Run the command; the words are those after its name."""
    parser = argparse.ArgumentParser(
        prog="array-server", description="Drive an ultrasound array with focal points."
    )
    add_arguments(parser)
    try:
        arguments = parser.parse_args(list(argv))
    except SystemExit as end:
        return int(end.code or 0)
    return carry_out(arguments)
