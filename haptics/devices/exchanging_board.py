# SPDX-License-Identifier: GPL-3.0-or-later
"""Serial boards that hold two patterns, one that sounds and one that is written, and exchange them.

Neither acknowledges anything, and neither has a watchdog: what was exchanged last sounds for ever.
"""

from __future__ import annotations

import contextlib
import math
from abc import abstractmethod

import numpy as np
from numpy.typing import NDArray

from .device import MODULATION_FREQUENCY, Device, DeviceError, Emission
from .serial_port import SerialPort, choose_port, load_pyserial

_PERIODS_A_FRAME = 4
"""Periods of modulation by exchanges that follow an upload at least: an upload is silent."""
_RENEW = 0.1
"""Silence is written again this often [s]: a board that was reset sounds by itself."""
_AHEAD = 0.006
"""Modulation is written this long before the wire runs dry [s]."""


class DeviceExchangingBoard(Device):
    """What such boards have in common.

    Where the board does not modulate by itself, the patterns of sound and of silence are exchanged
    at 200 Hz. Between two exchanges comes filling, a command that changes nothing, so that the
    serial clock itself keeps the time.

    Args:
        kind: The device's kind, to say which ports there are.
        address: Its port.
        baud: Bits a second.
        exchange: The byte that exchanges the patterns.
        filling: A byte that changes nothing; nothing for a board that modulates by itself.
    """

    def __init__(
        self, kind: str, address: str, *, baud: int, exchange: int, filling: int | None
    ) -> None:
        # Now, not when a guard must be quick.
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
        """All that writes a pattern, without the exchange that makes it sound.

        It must not matter if another upload was cut off before it.
        """

    @abstractmethod
    def _greeting(self) -> bytes:
        """What is written once when the port has been opened."""

    def _recovery(self) -> bytes:
        """What is written before silence, since an upload may have been cut off."""
        return b""

    def open(self, now: float) -> None:
        """Open the port, and write silence into both patterns."""
        self._let_go()
        self._port = SerialPort(choose_port(self._kind, self._address), self._baud)
        self._port.write(self._greeting(), now)
        self._silence(now)

    def busy(self, now: float) -> float:
        """Until the wire has taken the last frame and its periods of modulation [s]."""
        return max(0.0, self._frame_until - _AHEAD - now)

    def emit(self, emission: Emission, now: float) -> float:
        """Write the pattern, exchange, and begin to modulate."""
        data = self._upload(emission.drive, modulated=emission.modulated)
        modulating = emission.modulated and len(self._period) > 0
        follows = 0.0
        if modulating:
            if (self._sounding and not self._modulating) or now >= self._renew_at:
                data = self._silent_frame() + data
                self._renew_at = now + _RENEW
            data += self._period * _PERIODS_A_FRAME
            follows = self._opened.seconds_for(len(self._period) * _PERIODS_A_FRAME)
        else:
            data += self._exchange
        self._sounding, self._modulating = True, modulating
        self._frame_until = self._opened.write(data, now)
        self.held = emission.drive
        return self._frame_until - follows

    def off(self, now: float) -> None:
        """Throw away what has not left, and write silence into both patterns."""
        self._opened.discard(now)
        self._silence(now)

    def service(self, now: float) -> float:
        """Go on with the modulation; write silence again, in case the board was reset."""
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
        """Write silence, and wait until it has left."""
        if self._port is not None:
            with contextlib.suppress(DeviceError):
                self.off(now)
                self._port.drain()
        self._let_go()

    def _silence(self, now: float) -> None:
        self._sounding = self._modulating = False
        frame = self._silent_frame()
        self._frame_until = self._opened.write(self._recovery() + frame + frame, now)
        self._renew_at = now + _RENEW
        self.held = np.zeros(self.array.count, np.complex128)

    def _silent_frame(self) -> bytes:
        silence = np.zeros(self.array.count, np.complex128)
        return self._upload(silence, modulated=False) + self._exchange

    def _let_go(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None

    @property
    def _opened(self) -> SerialPort:
        if self._port is None:
            raise DeviceError(f"The {self._kind} is not connected.")
        return self._port
