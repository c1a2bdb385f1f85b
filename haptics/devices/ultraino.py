# SPDX-License-Identifier: GPL-3.0-or-later
"""Ultraino: three kinds of driver boards on a serial port (asiermarzo/Ultraino, MIT).

Tested only with emulators of their protocols, never on a device.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..acoustics.drive_steps import drive_steps
from ..acoustics.transducer_array import TransducerArray
from .device import MODULATION_FREQUENCY, Device, DeviceError, DeviceName, FoundDevice
from .exchanging_board import DeviceExchangingBoard
from .serial_port import list_ports

PHASES, EXCHANGE, AMPLITUDES, ENABLE_ALL = 254, 253, 251, 192

_MEGA_PORTS = _MEGA_DIVISIONS = 10
_MEGA_PINS = (
    *(51, 52, 53, 54, 28, 29, 30, 31, 47, 46, 45, 44, 43, 42, 41, 40),
    *(56, 57, 58, 59, 48, 49, 72, 69, 39, 38, 37, 36, 35, 34, 33, 32),
    *(21, 23, 65, 63, 9, 11, 13, 15, 20, 22, 64, 66, 8, 10, 12, 14),
    *(24, 25, 26, 27, 16, 17, 18, 19, 7, 6, 5, 4, 3, 2, 1, 0),
)
"""Position of each output of the driver shield in the Mega's ports: port times 8, plus bit."""
_MEGA_DURATION, _MEGA_COMMIT, _MEGA_EXCHANGE = 0x30, 0x10, 0x00


def list_devices() -> list[FoundDevice]:
    """Connected serial ports; which board is behind a port cannot be detected.

    Raises:
        DeviceError: pyserial is not installed.
    """
    return list_ports("ultraino")


def choose_board(name: DeviceName) -> Device:
    """Make ``ultraino:PORT,board=mega|fpga|fpga128,boards=N,array=PRESET|FILE.toml``.

    - *mega*: ArduinoMEGA64 at 115,200 baud, 10 phases, 64 outputs per board, 53 frames per second.
    - *fpga*: SimpleFPGA at 230,400 baud, 32 phases, 256 emitters, 30 frames per second.
    - *fpga128*: SimpleFPGA_128 at 1,500,000 baud, 128 phases, 72 emitters, 45 frames per second.

    The wiring is up to the builder: output n is assumed to drive transducer n of the array. The
    default array is 8 × 8, or 16 × 16 for *fpga*.

    Raises:
        DeviceError: An option is wrong, or the array does not fit the board.
    """
    name.check_options("board", "boards", "array")
    board = name.choice("board", ("mega", "fpga", "fpga128"))
    if board == "mega":
        return DeviceUltrainoMega(name)
    if "boards" in name.options:
        raise DeviceError("Only board=mega can be chained. Leave out boards.")
    if board == "fpga":
        return DeviceUltrainoFPGA(name, "sonicsurface", baud=230_400, divisions=32, emitters=256)
    return DeviceUltrainoFPGA(name, "ultraino", baud=1_500_000, divisions=128, emitters=72)


def _array(name: DeviceName, preset: str, *, divisions: int, outputs: int) -> TransducerArray:
    """The array connected to a board, with the board's number of phases."""
    chosen = name.options.get("array", preset)
    try:
        if chosen.endswith(".toml"):
            array = TransducerArray.from_toml(Path(chosen))
        else:
            array = TransducerArray.preset(chosen)
    except (OSError, ValueError) as error:
        raise DeviceError(f"The array {chosen} cannot be used: {error}") from error
    if array.count > outputs:
        raise DeviceError(
            f"The board has {outputs} outputs, too few for the {array.count} transducers of "
            f"{chosen}."
        )
    return replace(array, phase_steps=divisions, amplitude_steps=1)


class DeviceUltrainoFPGA(DeviceExchangingBoard):
    """SimpleFPGA and SimpleFPGA_128; see `choose_board`."""

    def __init__(
        self, name: DeviceName, preset: str, *, baud: int, divisions: int, emitters: int
    ) -> None:
        super().__init__("ultraino", name.address, baud=baud, exchange=EXCHANGE, filling=ENABLE_ALL)
        self.array = _array(name, preset, divisions=divisions, outputs=emitters)
        self._divisions = divisions
        self._emitters = emitters

    def _greeting(self) -> bytes:
        # An earlier program may have left other pulse widths in both patterns.
        full = bytes([AMPLITUDES]) + bytes([self._divisions // 2]) * self._emitters
        return bytes([ENABLE_ALL]) + (full + self._exchange) * 2

    def _upload(self, drive: NDArray[np.complex128], *, modulated: bool) -> bytes:
        phases, amplitudes = drive_steps(self.array, drive)
        pattern = np.full(self._emitters, self._divisions, np.uint8)
        pattern[: self.array.count] = np.where(amplitudes > 0, phases, self._divisions)
        return bytes([ENABLE_ALL, PHASES]) + pattern.tobytes()


class DeviceUltrainoMega(DeviceExchangingBoard):
    """ArduinoMEGA64; see `choose_board`. Boards in a chain have 64 outputs each.

    A pattern is a list of waveforms with durations in periods of 40 kHz, which the board repeats:
    100 periods of sound, then 100 of silence, give 200 Hz. The silent waveform remains in both
    patterns, so only the waveform of sound is uploaded.
    """

    def __init__(self, name: DeviceName) -> None:
        super().__init__(
            "ultraino", name.address, baud=115_200, exchange=_MEGA_EXCHANGE, filling=None
        )
        boards = name.number("boards", 1.0)
        if boards not in range(1, 15):
            raise DeviceError(f"A chain has 1 to 14 boards, not {boards:g}.")
        self._boards = int(boards)
        self.array = _array(name, "ultraino", divisions=_MEGA_DIVISIONS, outputs=64 * self._boards)

    def _greeting(self) -> bytes:
        silence = self._waveform(np.zeros(self.array.count, np.complex128)) * 2
        return bytes([_MEGA_EXCHANGE]) + (silence + bytes([_MEGA_EXCHANGE])) * 2

    def _recovery(self) -> bytes:
        # Only an exchange resets the write position.
        return self._exchange

    def _upload(self, drive: NDArray[np.complex128], *, modulated: bool) -> bytes:
        periods = round(40e3 / MODULATION_FREQUENCY / 2)
        durations = (periods, periods, 0) if modulated else (1, 0)
        parts = bytes(
            _MEGA_DURATION | ((duration << shift) & 0xC0)
            for duration in durations
            for shift in (0, 2, 4, 6)
        )
        return self._waveform(drive) + parts + bytes([_MEGA_COMMIT])

    def _waveform(self, drive: NDArray[np.complex128]) -> bytes:
        """One waveform for all boards: each byte holds four bits and the number of the board."""
        phases, amplitudes = drive_steps(self.array, drive)
        table = np.zeros((self._boards, _MEGA_DIVISIONS, _MEGA_PORTS), np.uint8)
        for index in np.flatnonzero(amplitudes > 0):
            board, output = divmod(int(index), 64)
            port, bit = divmod(_MEGA_PINS[output], 8)
            high = (int(phases[index]) + np.arange(_MEGA_DIVISIONS // 2)) % _MEGA_DIVISIONS
            table[board, high, port] |= 1 << bit
        halves = np.stack((table & 0xF0, (table << 4) & 0xF0), axis=-1)
        numbers = np.arange(1, self._boards + 1, dtype=np.uint8)[:, None]
        return (halves.reshape(self._boards, -1) | numbers).tobytes()
