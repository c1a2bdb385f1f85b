# SPDX-License-Identifier: GPL-3.0-or-later
"""SonicSurface: 256 transducers on a serial port at 230,400 baud (upnalab/SonicSurface, MIT).

A frame is ``FE``, 256 phase bytes, ``FD``, and takes 11.2 ms; nothing is acknowledged. A phase byte is
a delay in 32nds of a period, 32 is off. ``FD`` exchanges the pattern that sounds and the one that was
written last, so a lone one brings back what sounded before. The board starts with sound and has no
watchdog. Tried against an emulator of that protocol only, never on a device.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..drive_steps import drive_steps
from ..transducer_array import TransducerArray
from .device import MODULATION_FREQUENCY, Device, DeviceError, DeviceName, Emission
from .serial_port import SerialPort, choose_port

BAUD = 230_400
START, SWAP, OFF = 0xFE, 0xFD, 32
CLOCKS_ON = 0x97
PRIMARY, SECONDARY = 0xC0, 0xC1
MODULATION = 0xA0
_TACTILE_STEP = round(1250 / MODULATION_FREQUENCY) - 1
"""The tactile firmware modulates at 1,250 Hz / (step + 1)."""
_PERIODS_A_FRAME = 4
"""Periods of modulation that sound between two uploads on the stock firmware: an upload is silent."""
_RENEW = 0.1
"""Silence is written again this often [s]: a board that was reset sounds by itself."""
_AHEAD = 0.006
"""Modulation is written this long before the wire runs dry [s]."""


def board_order(array: TransducerArray) -> NDArray[np.int64]:
    """Which byte of a frame each transducer of the array has, shape [T].

    Args:
        array: A grid of columns (along X) and rows (along Y), in its own coordinates.
    """
    x, y = array.positions[:, 0], array.positions[:, 1]
    pitch = float(np.min(np.diff(np.unique(np.round(x, 6)))))
    column = np.rint((x - x.min()) / pitch).astype(np.int64)
    row = np.rint((y - y.min()) / pitch).astype(np.int64)
    within = np.array(((0, 7, 1, 2), (4, 3, 6, 5)))
    return np.asarray(64 * (column // 4) + 8 * (row // 2) + within[row % 2, column % 4])


class DeviceSonicSurface(Device):
    """``sonicsurface:PORT,firmware=stock|tactile,boards=1|2``.

    With the *tactile* firmware the board itself modulates, at 208 Hz (the step of 1,250 Hz that is
    nearest to 200), whatever an emission asks for; phases are in 16ths, and it takes 88 frames a
    second. With the *stock* firmware the patterns of sound and of silence are exchanged at 200 Hz.
    Between two exchanges comes filling that selects the board that is selected already, so the serial
    clock itself keeps the time. An upload is silent and four periods follow each, so it takes 30 frames
    a second. With two boards the array's bytes are halved between them.
    """

    def __init__(self, name: DeviceName) -> None:
        name.check_options("firmware", "boards")
        self._address = name.address
        self._tactile = name.choice("firmware", ("stock", "tactile")) == "tactile"
        self._two_boards = name.choice("boards", ("1", "2")) == "2"
        if self._tactile and self._two_boards:
            raise DeviceError("The tactile firmware drives one board only. Leave boards=2 out.")
        array = TransducerArray.preset("sonicsurface")
        self.array = replace(array, phase_steps=16) if self._tactile else array
        self._order = board_order(self.array)
        self._silence = bytes([OFF]) * self.array.count
        self._port: SerialPort | None = None
        self._sounding = False
        self._modulating = False
        self._frame_until = 0.0
        self._renew_at = 0.0
        period = round(BAUD / 10 / MODULATION_FREQUENCY)
        self._period = self._exchange(period // 2) + self._exchange(period - period // 2)

    def open(self, now: float) -> None:
        """Open the port, start the shift clocks, and write silence into both patterns."""
        self._let_go()
        self._port = SerialPort(choose_port("sonicsurface", self._address), BAUD)
        if not self._tactile:
            self._port.write(bytes([CLOCKS_ON]), now)
        self.off(now)

    def busy(self, now: float) -> float:
        """Until the wire has taken the last frame and its periods of modulation [s]."""
        return max(0.0, self._frame_until - _AHEAD - now)

    def emit(self, emission: Emission, now: float) -> float:
        """Write the pattern, exchange, and begin to modulate."""
        phases, amplitudes = drive_steps(self.array, emission.drive)
        delays = np.where(amplitudes > 0, phases * (2 if self._tactile else 1), OFF)
        pattern = np.empty(self.array.count, np.uint8)
        pattern[self._order] = delays
        data = self._upload(pattern.tobytes())
        modulating = emission.modulated and not self._tactile
        if not modulating:
            data += bytes([SWAP])
        else:
            if (self._sounding and not self._modulating) or now >= self._renew_at:
                data = self._upload(self._silence) + bytes([SWAP]) + data
                self._renew_at = now + _RENEW
            data += self._period * _PERIODS_A_FRAME
        self._sounding, self._modulating = True, modulating
        self._frame_until = self._opened.write(data, now)
        self.held = emission.drive
        return self._frame_until - len(self._period) * _PERIODS_A_FRAME * 10 / BAUD * modulating

    def off(self, now: float) -> None:
        """Throw away what has not left, and write silence into both patterns."""
        self._sounding = self._modulating = False
        self._opened.discard(now)
        frame = self._upload(self._silence) + bytes([SWAP])
        self._frame_until = self._opened.write(frame + frame, now)
        self._renew_at = now + _RENEW
        self.held = np.zeros(self.array.count, np.complex128)

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
            port.write(self._upload(self._silence) + bytes([SWAP]), now)
            self._renew_at = now + _RENEW
        return max(0.001, self._renew_at - now)

    def close(self, now: float) -> None:
        """Write silence, and wait until it has left."""
        if self._port is not None:
            try:
                self.off(now)
                self._port.drain()
            except DeviceError:
                pass
        self._let_go()

    def _let_go(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None

    @property
    def _opened(self) -> SerialPort:
        if self._port is None:
            raise DeviceError("The SonicSurface is not connected.")
        return self._port

    def _exchange(self, count: int) -> bytes:
        """An exchange, and filling that makes it last for a number of bytes."""
        return bytes([SWAP]) + bytes([PRIMARY]) * (count - 1)

    def _upload(self, phases: bytes) -> bytes:
        """All that writes a pattern, without the exchange that makes it sound.

        It begins so that a frame that was cut off before it does not matter: a board obeys the start
        only while it is selected.
        """
        if self._tactile:
            return bytes([MODULATION | _TACTILE_STEP, START]) + phases
        if not self._two_boards:
            return bytes([PRIMARY, START]) + phases
        half = len(phases) // 2
        return (
            bytes([PRIMARY, START, SECONDARY, START, PRIMARY])
            + phases[:half]
            + bytes([SECONDARY])
            + phases[half:]
        )
