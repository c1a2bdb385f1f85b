# SPDX-License-Identifier: GPL-3.0-or-later
"""A second process that silences an array whose server was killed or hangs.

Most open arrays have no watchdog: the last pattern sounds for ever. The server cannot silence them
after a SIGKILL, so a guard waits beside it, in a session of its own. It does nothing until the
server ends without saying so, or says for a second that there is sound and then nothing more. Then
it kills what hangs, opens the device itself, which makes it silent, and ends.

What this does not cover: both processes killed at once, the machine losing its power while the
array keeps its own.
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
"""A server that has sound on and is not heard of for this long hangs [s]."""
_TRIES_FOR = 10.0
"""How long the guard tries to reach the device [s]: an adapter may be plugged in again."""
_SOUND, _SILENCE, _END = b"E", b"S", b"Q"


class Guard:
    """The server's end of it.

    Args:
        device: Name of the device to guard.
    """

    def __init__(self, device: str) -> None:
        self._device = device
        self._process = self._start()

    def _start(self) -> subprocess.Popen[bytes]:
        words = [self._device, str(os.getpid())]
        process = start_process("guard", words, stdout=subprocess.PIPE)
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
        """Whether it is on guard, which takes it a moment: there should be no sound before."""
        return self._ready.is_set() and self._process.poll() is None

    def beat(self, *, emitting: bool) -> None:
        """Say that all is well; call it at least every 0.3 s. A guard that has gone is replaced."""
        if self._process.poll() is not None:
            self._process = self._start()
        self._write(_SOUND if emitting else _SILENCE)

    def end(self, *, silent: bool) -> None:
        """Let it end; with sound left, it does its work first."""
        if silent:
            self._write(_END)
        with contextlib.suppress(OSError):
            if self._process.stdin is not None:
                self._process.stdin.close()
        if silent:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(2.0)

    def _write(self, byte: bytes) -> None:
        # One that has just gone is replaced at the next beat.
        with contextlib.suppress(OSError):
            if self._process.stdin is not None:
                self._process.stdin.write(byte)


def wait_for_trouble(stream: BinaryIO, hangs_after: float = _HANGS_AFTER) -> str:
    """Listen to the server.

    Args:
        stream: What it writes.
        hangs_after: With sound on, a pause longer than this [s] is trouble.

    Returns:
        ``ended`` if it ended as it should, ``gone`` if it did not, ``hangs`` if it is not heard of.
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


def silence(device: Device, *, tries_for: float = _TRIES_FOR) -> bool:
    """Open a device and close it, which makes it silent, again and again until that has worked.

    Returns:
        Whether it has.
    """
    end = time.monotonic() + tries_for
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
    """Guard the server that started this process; the words are the device and its process id."""
    name, parent = argv[0], int(argv[1])
    for word in ("SIGINT", "SIGTERM", "SIGHUP"):
        if hasattr(signal, word):
            signal.signal(getattr(signal, word), signal.SIG_IGN)
    # Whatever must be imported is imported now, while there is time.
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
        print(f"array-server: its guard has silenced {name}", file=sys.stderr)
        return 0
    print(
        f"array-server: {name} cannot be reached and may still sound. Switch its power off.",
        file=sys.stderr,
    )
    return 1
