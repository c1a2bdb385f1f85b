# SPDX-License-Identifier: GPL-3.0-or-later
"""A second process that silences an array whose server was killed or hangs.

Most open arrays have no watchdog and emit the last pattern forever. The server cannot silence them
after a SIGKILL, so a guard process runs next to it in its own process session. It does nothing
until the server ends without notice, or sends no sign of life for a second while there is sound. It
then kills a hanging server, silences the device by opening it, and exits.

This does not cover both processes being killed at once, or the computer losing power while the
array keeps it.
"""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from typing import BinaryIO

from ..devices import Device, DeviceError, make_device
from .launch import start_process

_HANGS_AFTER = 1.0
"""A server without a sign of life for this long while there is sound counts as hanging [s]."""
_RETRY_TIME = 10.0
"""How long the guard tries to reach the device [s]: an adapter may be plugged in again."""
_SOUND, _SILENCE, _END = b"E", b"S", b"Q"


class Guard:
    """The server's side of the guard: starts the process and sends it signs of life.

    Args:
        device: Name of the device to guard.
    """

    def __init__(self, device: str) -> None:
        self._device = device
        self._process = self._start()

    def _start(self) -> subprocess.Popen[bytes]:
        arguments = [self._device, str(os.getpid())]
        process = start_process("guard", arguments, stdout=subprocess.PIPE)
        ready = self._ready = threading.Event()

        def wait_until_ready() -> None:
            assert process.stdout is not None
            with process.stdout as stream:
                if stream.read(1):
                    ready.set()

        threading.Thread(target=wait_until_ready, daemon=True).start()
        # A guard that hangs must not make the server wait.
        with contextlib.suppress(OSError, AttributeError):
            if process.stdin is not None:
                os.set_blocking(process.stdin.fileno(), False)
        return process

    @property
    def ready(self) -> bool:
        """Whether the guard is running. It takes a moment to start; allow no sound before."""
        return self._ready.is_set() and self._process.poll() is None

    def beat(self, *, emitting: bool) -> None:
        """Send a sign of life, at least every 0.3 s; restarts a guard that has ended."""
        if self._process.poll() is not None:
            self._process = self._start()
        self._write(_SOUND if emitting else _SILENCE)

    def end(self, *, silent: bool) -> None:
        """End the guard; if the array is not silent, the guard silences it first."""
        if silent:
            self._write(_END)
        with contextlib.suppress(OSError):
            if self._process.stdin is not None:
                self._process.stdin.close()
        if silent:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(2.0)

    def _write(self, byte: bytes) -> None:
        # A guard that has just ended is replaced at the next beat.
        with contextlib.suppress(OSError):
            if self._process.stdin is not None:
                self._process.stdin.write(byte)


def wait_for_trouble(stream: BinaryIO, hangs_after: float = _HANGS_AFTER) -> str:
    """Listen to the server until it ends or hangs.

    Args:
        stream: The server's signs of life.
        hangs_after: Maximum time between them while there is sound [s].

    Returns:
        ``ended`` after a normal end, ``gone`` after any other end, ``hangs`` if it hangs.
    """
    heard: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def listen() -> None:
        while True:
            byte = stream.read(1)
            heard.put(byte)
            if not byte:
                return

    threading.Thread(target=listen, daemon=True).start()
    last = _SILENCE
    while True:
        try:
            byte = heard.get(timeout=hangs_after if last == _SOUND else None)
        except queue.Empty:
            return "hangs"
        if not byte:
            return "ended" if last == _END else "gone"
        last = byte


def silence(device: Device, *, retry_time: float = _RETRY_TIME) -> bool:
    """Silence a device by opening and closing it, with retries.

    Returns:
        Whether it succeeded.
    """
    end = time.monotonic() + retry_time
    while True:
        try:
            device.open(time.monotonic())
        except DeviceError:
            if time.monotonic() > end:
                return False
            time.sleep(0.02)
        else:
            device.close(time.monotonic())
            return True


def main(argv: Sequence[str]) -> int:
    """Guard the server that started this process; arguments are the device and its process ID."""
    name, parent = argv[0], int(argv[1])
    for signal_name in ("SIGINT", "SIGTERM", "SIGHUP"):
        if hasattr(signal, signal_name):
            signal.signal(getattr(signal, signal_name), signal.SIG_IGN)
    # This imports everything needed now, while there is time.
    device = make_device(name)
    sys.stdout.write("R")
    sys.stdout.close()
    trouble = wait_for_trouble(sys.stdin.buffer)
    if trouble == "ended":
        return 0
    if trouble == "hangs":
        with contextlib.suppress(OSError):
            os.kill(parent, getattr(signal, "SIGKILL", signal.SIGTERM))
    if silence(device):
        print(f"array-server: the guard has silenced {name}", file=sys.stderr)
        return 0
    print(
        f"array-server: {name} cannot be reached and may still be emitting. Switch off its power.",
        file=sys.stderr,
    )
    return 1
