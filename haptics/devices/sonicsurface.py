# SPDX-License-Identifier: GPL-3.0-or-later
"""SonicSurface: 256 transducers on a serial port at 230,400 baud (upnalab/SonicSurface, MIT).

A frame is ``FE``, 256 phase bytes, ``FD``, and takes 11.2 ms; nothing is acknowledged. A phase byte
is a delay in 32nds of a period; 32 is off. ``FD`` exchanges the pattern being emitted with the one
written last, so a second ``FD`` restores the previous one. The stock board sounds after power-up.
Tested only with an emulator of this protocol, never on a device.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..acoustics.drive_steps import drive_steps
from ..acoustics.transducer_array import TransducerArray
from .device import MODULATION_FREQUENCY, DeviceError, DeviceName, FoundDevice
from .exchanging_board import DeviceExchangingBoard
from .serial_port import list_ports

BAUD = 230_400
START, EXCHANGE, OFF = 0xFE, 0xFD, 32
CLOCKS_ON = 0x97
PRIMARY, SECONDARY = 0xC0, 0xC1
MODULATION = 0xA0
_TACTILE_STEP = round(1250 / MODULATION_FREQUENCY) - 1
"""The tactile firmware modulates at 1,250 Hz / (step + 1)."""


def list_devices() -> list[FoundDevice]:
    """Connected serial ports; which board is behind a port cannot be detected.

    Raises:
        DeviceError: pyserial is not installed.
    """
    return list_ports("sonicsurface")


def board_order(array: TransducerArray) -> NDArray[np.int64]:
    """Index of each transducer's byte in a frame, shape [T].

    Args:
        array: A grid of columns (along X) and rows (along Y), in its own coordinates.
    """
    x, y = array.positions[:, 0], array.positions[:, 1]
    pitch = float(np.min(np.diff(np.unique(np.round(x, 6)))))
    column = np.rint((x - x.min()) / pitch).astype(np.int64)
    row = np.rint((y - y.min()) / pitch).astype(np.int64)
    within = np.array(((0, 7, 1, 2), (4, 3, 6, 5)))
    return np.asarray(64 * (column // 4) + 8 * (row // 2) + within[row % 2, column % 4])


class DeviceSonicSurface(DeviceExchangingBoard):
    """``sonicsurface:PORT,firmware=stock|tactile,boards=1|2``.

    With the *tactile* firmware, the board itself modulates at 208 Hz (the division of 1,250 Hz
    nearest to 200 Hz), even if an emission should not be modulated. Phases are in 16ths of a
    period, and the rate is 88 frames per second. The *stock* firmware is modulated by exchanges, at
    30 frames per second. With two boards, each gets half of the array's bytes.
    """

    def __init__(self, name: DeviceName) -> None:
        name.check_options("firmware", "boards")
        self._tactile = name.choice("firmware", ("stock", "tactile")) == "tactile"
        self._two_boards = name.choice("boards", ("1", "2")) == "2"
        if self._tactile and self._two_boards:
            raise DeviceError("The tactile firmware drives only one board. Leave out boards=2.")
        super().__init__(
            "sonicsurface",
            name.address,
            baud=BAUD,
            exchange=EXCHANGE,
            # This selects the board that is already selected.
            filling=None if self._tactile else PRIMARY,
        )
        array = TransducerArray.preset("sonicsurface")
        self.array = replace(array, phase_steps=16) if self._tactile else array
        self._order = board_order(self.array)

    def _greeting(self) -> bytes:
        return b"" if self._tactile else bytes([CLOCKS_ON])

    def _upload(self, drive: NDArray[np.complex128], *, modulated: bool) -> bytes:
        phases, amplitudes = drive_steps(self.array, drive)
        pattern = np.empty(self.array.count, np.uint8)
        pattern[self._order] = np.where(amplitudes > 0, phases * (2 if self._tactile else 1), OFF)
        data = pattern.tobytes()
        # A board obeys START only while selected, and it may have been deselected before.
        if self._tactile:
            return bytes([MODULATION | _TACTILE_STEP, START]) + data
        if not self._two_boards:
            return bytes([PRIMARY, START]) + data
        half = len(data) // 2
        head = bytes([PRIMARY, START, SECONDARY, START, PRIMARY])
        return head + data[:half] + bytes([SECONDARY]) + data[half:]
