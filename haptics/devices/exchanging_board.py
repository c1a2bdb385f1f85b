# SPDX-License-Identifier: GPL-3.0-or-later
"""Serial boards with two patterns, one being emitted and one being written, that are exchanged.

They acknowledge nothing and have no watchdog: the last pattern is emitted forever.
"""

from __future__ import annotations

import contextlib
import math
from abc import abstractmethod

import numpy as np
from numpy.typing import NDArray

from .device import MODULATION_FREQUENCY, Device, DeviceError, Emission
from .serial_port import SerialPort, choose_port, load_pyserial

_PERIODS_PER_FRAME = 4
"""Minimum number of modulation periods after an upload, because the board is silent during one."""
_RENEW = 0.1
"""Interval at which silence is written again [s]: a board sounds by itself after a reset."""
_AHEAD = 0.006
"""Modulation is written this long before the wire becomes idle [s]."""


class DeviceExchangingBoard(Device):
    """Base class of such boards.

    If the board does not modulate by itself, a pattern of sound and one of silence are exchanged at
    200 Hz. The time between two exchanges is filled with a command that changes nothing, so that
    the serial clock gives the timing.

    Args:
        kind: Kind of the device, to list its possible ports.
        address: Serial port.
        baud: Bits per second.
        exchange: The byte that exchanges the patterns.
        filling: A byte that changes nothing; None for a board that modulates by itself.
    """

    def __init__(
        self, kind: str, address: str, *, baud: int, exchange: int, filling: int | None
    ) -> None:
        # Import it now, because a guard has no time for it later.
        load_pyserial()
        self._kind = kind
        self._address = address
        self._baud = baud
        self._exchange = bytes([exchange])
        self._port: SerialPort | None = None
        self._sounding = False
        self._modulating = False
        self._frame_until = 0.0
        self._renew_at = 0.0
        self._period = b""
        if filling is not None:
            count = round(baud / 10 / MODULATION_FREQUENCY)
            for part in (count // 2, count - count // 2):
                self._period += self._exchange + bytes([filling]) * (part - 1)

    @abstractmethod
    def _upload(self, drive: NDArray[np.complex128], *, modulated: bool) -> bytes:
        """The bytes that write a pattern, without the exchange that starts emitting it.

        They must work even after an incomplete upload.
        """

    @abstractmethod
    def _greeting(self) -> bytes:
        """The bytes to write once after opening the port."""

    def _recovery(self) -> bytes:
        """The bytes to write before silence, because the last upload may be incomplete."""
        return b""

    def open(self, now: float) -> None:
        """Open the port, and write silence to both patterns."""
        self._release()
        self._port = SerialPort(choose_port(self._kind, self._address), self._baud)
        self._port.write(self._greeting(), now)
        self._silence(now)

    def busy(self, now: float) -> float:
        """Time until the last frame and its modulation periods have been transmitted [s]."""
        return max(0.0, self._frame_until - _AHEAD - now)

    def emit(self, emission: Emission, now: float) -> float:
        """Write the pattern, exchange patterns, and start modulating."""
        data = self._upload(emission.drive, modulated=emission.modulated)
        modulating = emission.modulated and len(self._period) > 0
        follows = 0.0
        if modulating:
            if (self._sounding and not self._modulating) or now >= self._renew_at:
                data = self._silent_frame() + data
                self._renew_at = now + _RENEW
            data += self._period * _PERIODS_PER_FRAME
            follows = self._opened.seconds_for(len(self._period) * _PERIODS_PER_FRAME)
        else:
            data += self._exchange
        self._sounding, self._modulating = True, modulating
        self._frame_until = self._opened.write(data, now)
        self.held = emission.drive
        return self._frame_until - follows

    def off(self, now: float) -> None:
        """Discard data not yet transmitted, and write silence to both patterns."""
        self._opened.discard(now)
        self._silence(now)

    def service(self, now: float) -> float:
        """Continue the modulation, or write silence again in case the board was reset."""
        port = self._opened
        port.check()
        if self._modulating:
            while port.pending(now) < _AHEAD:
                port.write(self._period, now)
            return port.pending(now) - _AHEAD
        if self._sounding:
            return math.inf
        if now >= self._renew_at and port.pending(now) == 0.0:
            port.write(self._silent_frame(), now)
            self._renew_at = now + _RENEW
        return max(0.001, self._renew_at - now)

    def close(self, now: float) -> None:
        """Write silence, and wait until it has been transmitted."""
        if self._port is not None:
            with contextlib.suppress(DeviceError):
                self.off(now)
                self._port.drain()
        self._release()

    def _silence(self, now: float) -> None:
        self._sounding = self._modulating = False
        frame = self._silent_frame()
        self._frame_until = self._opened.write(self._recovery() + frame + frame, now)
        self._renew_at = now + _RENEW
        self.held = np.zeros(self.array.count, np.complex128)

    def _silent_frame(self) -> bytes:
        silence = np.zeros(self.array.count, np.complex128)
        return self._upload(silence, modulated=False) + self._exchange

    def _release(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None

    @property
    def _opened(self) -> SerialPort:
        if self._port is None:
            raise DeviceError(f"The {self._kind} is not connected.")
        return self._port
