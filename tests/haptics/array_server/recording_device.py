# SPDX-License-Identifier: GPL-3.0-or-later
"""A device that records its calls, and a server around it whose clock the test controls."""

from __future__ import annotations

import socket
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_clay.haptics import TransducerArray
from tactile_clay.haptics.array_server.limits import Limits
from tactile_clay.haptics.array_server.server import ArrayServer
from tactile_clay.haptics.devices import Device, DeviceError, Emission
from tactile_clay.haptics.protocol.datagram import Kind, encode


class RecordingDevice(Device):
    """Accepts everything immediately."""

    def __init__(self, preset: str = "sonicsurface") -> None:
        self.array = TransducerArray.preset(preset)
        self.emissions: list[tuple[float, Emission]] = []
        self.log: list[str] = []
        self.sounds = True
        self.broken = False
        self.held = np.zeros(self.array.count, np.complex128)

    def _do(self, word: str) -> None:
        if self.broken:
            raise DeviceError("It is broken.")
        self.log.append(word)

    def open(self, now: float) -> None:
        self._do("open")
        self.sounds = False

    def busy(self, now: float) -> float:
        return 0.0

    def emit(self, emission: Emission, now: float) -> float:
        self._do("emit")
        self.emissions.append((now, emission))
        self.sounds = True
        return now

    def off(self, now: float) -> None:
        self._do("off")
        self.sounds = False

    def close(self, now: float) -> None:
        if not self.broken:
            self.log.append("close")
            self.sounds = False


class Bench:
    """A server in this process, and a socket to send datagrams to it."""

    def __init__(self, *, limits: Limits | None = None, preset: str = "sonicsurface") -> None:
        self.now = 1000.0
        self.device = RecordingDevice(preset)
        self.server = ArrayServer(self.device, limits=limits, session=77, clock=lambda: self.now)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.sequence = 0

    def send_bytes(self, data: bytes) -> None:
        """Send bytes, and let the server handle them."""
        self.socket.sendto(data, ("127.0.0.1", self.server.port))
        self.server.step(0.0)

    def send(
        self,
        rows: NDArray[np.floating] | list[tuple[float, float, float, float]],
        **changes: Any,
    ) -> None:
        """Send valid focal points, with changes to the header."""
        table = np.asarray(rows, np.float32).reshape(-1, 4)
        self.sequence += 1
        values: dict[str, Any] = {"session": 77, "sequence": self.sequence, "time": self.now}
        self.send_bytes(
            encode(
                Kind.FOCI,
                **(values | changes),
                positions=table[:, :3],
                pressures=table[:, 3],
            )
        )

    def pass_time(self, seconds: float, step: float = 0.01) -> None:
        """Advance the clock in steps, with a pass of the server's loop after each."""
        for _ in range(round(seconds / step)):
            self.now += step
            self.server.step(0.0)

    def close(self) -> None:
        """Close the server."""
        self.socket.close()
        self.server.close()
