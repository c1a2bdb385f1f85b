# SPDX-License-Identifier: GPL-3.0-or-later
"""Ultraleap STRATOS Explore, through a bridge program that users build with their own SDK.

The SDK is proprietary and has no Python binding, so ``bridge.cpp`` in this folder passes focal
points to it; CMakeLists.txt explains how to build it with SDK 2 or 3. The SDK computes the drive.
Its intensity, 0 to 1, has no unit; here it is the pressure relative to a full scale. Tested only
with headers written from the SDK's documentation, never with the SDK or a device.
"""

from __future__ import annotations

import contextlib
import queue
import secrets
import socket
import subprocess
import threading
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...acoustics.transducer_array import TransducerArray
from ...protocol.datagram import Kind, Modulation, encode
from ..device import Device, DeviceError, DeviceName, Emission

_FRAME_SECONDS = 0.010
"""Minimum time between two updates of the SDK [s]."""
_CONNECT_TIMEOUT = 5.0
_KEEP_ALIVE = 0.05


class DeviceStratosExplore(Device):
    """``stratos_explore:BRIDGE,full=PA``: the path of the bridge, and the pressure of intensity 1.

    The bridge acts as a watchdog: it stops the array if it receives nothing for 150 ms or the
    server is gone.
    """

    takes_foci = True
    has_watchdog = True
    maximum_foci = 8

    def __init__(self, name: DeviceName) -> None:
        name.check_options("full")
        self.array = TransducerArray.preset("stratos_explore")
        self._path = name.address
        self._full = name.number("full", 1000.0)
        if not self._path:
            raise DeviceError(
                "Give the path of the bridge program, as stratos_explore:/path/to/stratos_bridge. "
                f"{Path(__file__).parent / 'CMakeLists.txt'} explains how to build it."
            )
        if self._full <= 0.0:
            raise DeviceError(f"full must be a pressure above 0 Pa, not {self._full:g}.")
        self._process: subprocess.Popen[str] | None = None
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._socket: socket.socket | None = None
        self._session = secrets.randbelow(2**32)
        self._sequence = 0
        self._free_at = 0.0

    def open(self, now: float) -> None:
        """Start the bridge, which connects to the array and is silent at first."""
        self.close(now)
        try:
            process = subprocess.Popen(
                [self._path, str(self._session)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
        except OSError as error:
            raise DeviceError(
                f"The bridge {self._path} cannot be started ({error.strerror}). Build it with your "
                f"SDK as explained in {Path(__file__).parent / 'CMakeLists.txt'}."
            ) from error
        self._process, self._lines = process, queue.SimpleQueue()
        threading.Thread(target=_listen, args=(process, self._lines), daemon=True).start()
        try:
            line = self._lines.get(timeout=_CONNECT_TIMEOUT)
        except queue.Empty:
            line = ""
        words = line.split(maxsplit=2)
        if len(words) != 3 or words[0] != "ready":
            self.close(now)
            reason = line.removeprefix("failed").strip() or "it does not answer"
            raise DeviceError(f"The bridge {self._path} did not connect: {reason}.")
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.connect(("127.0.0.1", int(words[1])))
        self._limit = int(words[2])

    def busy(self, now: float) -> float:
        """Time until the SDK accepts the next update [s]."""
        return max(0.0, self._free_at - now)

    def emit(self, emission: Emission, now: float) -> float:
        """Send focal points with their intensities; if there are too many, the strongest."""
        order = np.argsort(-emission.pressures, kind="stable")[: self._limit]
        intensity = np.minimum(emission.pressures[order] / self._full, emission.amplitude_cap)
        modulation = Modulation.AMPLITUDE if emission.modulated else Modulation.NONE
        self._send(emission.positions[order], intensity, modulation, now)
        self._free_at = now + _FRAME_SECONDS
        return now

    def off(self, now: float) -> None:
        """Send an empty list of focal points."""
        self._send(np.zeros((0, 3)), np.zeros(0), Modulation.AMPLITUDE, now)

    def service(self, now: float) -> float:
        """Check that the bridge is still running."""
        process = self._process
        if process is None or process.poll() is not None:
            lines = []
            with contextlib.suppress(queue.Empty):
                while True:
                    lines.append(self._lines.get_nowait())
            reason = " ".join(lines).removeprefix("failed").strip() or "it has ended"
            raise DeviceError(f"The bridge is gone: {reason}.")
        return _KEEP_ALIVE

    def close(self, now: float) -> None:
        """End the bridge, which stops the array."""
        if self._socket is not None:
            with contextlib.suppress(DeviceError):
                self.off(now)
            self._socket.close()
            self._socket = None
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None
        with contextlib.suppress(OSError):
            process.stdin.close()
        try:
            process.wait(1.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def _send(
        self,
        positions: NDArray[np.floating],
        intensities: NDArray[np.floating],
        modulation: Modulation,
        now: float,
    ) -> None:
        if self._socket is None:
            raise DeviceError("The bridge is not connected.")
        self._sequence += 1
        data = encode(
            Kind.FOCI,
            session=self._session,
            sequence=self._sequence,
            time=max(0.0, now),
            modulation=modulation,
            positions=positions,
            pressures=intensities,
        )
        try:
            self._socket.send(data)
        except OSError as error:
            raise DeviceError(f"The bridge does not accept data ({error.strerror}).") from error


def _listen(process: subprocess.Popen[str], lines: queue.SimpleQueue[str]) -> None:
    assert process.stdout is not None
    with process.stdout:
        for line in process.stdout:
            lines.put(line.strip())
