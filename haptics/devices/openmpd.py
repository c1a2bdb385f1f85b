# SPDX-License-Identifier: GPL-3.0-or-later
"""OpenMPD boards (AsierInho) with an FTDI chip (RMResearch/OpenMPD_Driver, MIT).

A message has 512 bytes: 256 phases in 128ths of a period, ordered by pin, then 256 pulse widths in
64ths of half a period. The high bit of the first byte marks the start of a message, that of the
26th a change of the LED. There is no watchdog. Tested with a pyusb backend that simulates the
board, never on a device.
"""

from __future__ import annotations

import contextlib
import math
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..acoustics.drive_steps import drive_steps
from ..acoustics.transducer_array import TransducerArray
from .device import MODULATION_FREQUENCY, Device, DeviceError, DeviceName, Emission, FoundDevice
from .ftdi_fifo import FtdiFifo, find_chips, load_pyusb, serial_number

COUNT, PHASE_STEPS, WIDTH_STEPS = 256, 128, 64
_FLAG = 128
_LIGHT = 25
_HALF_PERIOD = 0.5 / MODULATION_FREQUENCY
_RENEW = 0.1
_OFF_COPIES = 16
"""The driver's own example sends a message 16 times to flush it through all buffers."""


def list_devices() -> list[FoundDevice]:
    """Connected FTDI chips; a board file tells which of them belongs to a board.

    Raises:
        DeviceError: pyusb or libusb is missing.
    """
    return [
        FoundDevice(
            "openmpd:board_N.pat",
            f"FTDI chip {serial_number(chip) or 'without a readable serial number'} "
            f"({chip.idVendor:04x}:{chip.idProduct:04x}), if board_N.pat names it",
        )
        for chip in find_chips()
    ]


@dataclass(frozen=True)
class BoardFile:
    """Content of a board file ``board_N.pat``."""

    serial: str
    """Serial number of the board's FTDI chip."""
    positions: NDArray[np.float64]
    """Positions of the transducers [m], shape [256, 3]."""
    pins: NDArray[np.int64]
    """Index of each transducer in a message, shape [256]."""
    phase_adjust: NDArray[np.float64]
    """Phase that each transducer adds [rad], shape [256]."""
    amplitude_adjust: NDArray[np.float64]
    """Factor for the amplitude of each transducer, shape [256]."""

    @classmethod
    def read(cls, path: Path) -> BoardFile:
        """Read a file.

        Raises:
            DeviceError: The file cannot be read or is not a board file; the message says why.
        """
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise DeviceError(f"The board file {path} cannot be read ({error}).") from error
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        if len(lines) < 7:
            raise DeviceError(f"{path} has {len(lines)} lines; a board file has 7.")
        for line, number, what in ((lines[1], COUNT, "transducers"), (lines[2], 128, "phases")):
            if line != str(number):
                raise DeviceError(f"{path} is for a board with {line} {what}, not {number}.")
        places = re.findall(r"\(([^()]*)\)", lines[3])
        positions = np.array([_numbers(path, place, 3, "position") for place in places])
        if positions.shape != (COUNT, 3):
            raise DeviceError(f"{path} has {len(places)} positions, not {COUNT}.")
        pins = _numbers(path, lines[4], COUNT, "pin")
        if sorted(pins) != list(range(COUNT)):
            raise DeviceError(f"{path}: the pins must be the numbers 0 to {COUNT - 1}, each once.")
        amplitude_adjust = np.array(_numbers(path, lines[6], COUNT, "amplitude"))
        if not ((amplitude_adjust >= 0.0) & (amplitude_adjust <= 1.0)).all():
            raise DeviceError(f"{path}: factors of amplitudes must be from 0 to 1.")
        return cls(
            lines[0],
            positions,
            np.array(pins, np.int64),
            np.radians(_numbers(path, lines[5], COUNT, "phase")),
            amplitude_adjust,
        )


def _numbers(path: Path, text: str, count: int, what: str) -> list[float]:
    parts = [part for part in text.split(",") if part.strip()]
    try:
        values = [float(part) for part in parts]
    except ValueError as error:
        raise DeviceError(f"{path}: a {what} is not a number ({error}).") from error
    if len(values) != count or not all(map(math.isfinite, values)):
        raise DeviceError(f"{path} has {len(values)} numbers for the {what}, not {count}.")
    return values


class DeviceOpenMPD(Device):
    """``openmpd:board_N.pat``: the board that the file describes.

    The host modulates it, with alternating messages of sound and silence, 400 per second.
    """

    def __init__(self, name: DeviceName) -> None:
        name.check_options()
        if not name.address:
            raise DeviceError("Give the board file, as in openmpd:/path/to/board_N.pat.")
        self._file = BoardFile.read(Path(name.address))
        # Import it now, because a guard has no time for it later.
        load_pyusb()
        preset = TransducerArray.preset("openmpd")
        self.array = replace(
            preset,
            positions=self._file.positions,
            normals=np.array((0.0, 0.0, 1.0)),
            phase_offsets=self._file.phase_adjust,
        )
        self._chip: FtdiFifo | None = None
        self._silence = bytearray(2 * COUNT)
        self._silence[0] = self._silence[_LIGHT] = _FLAG
        self._message = bytes(self._silence)
        self._sounding = False
        self._modulated = False
        self._high = False
        self._next_at = 0.0
        self._free_at = 0.0

    def open(self, now: float) -> None:
        """Open the chip, and send silence."""
        self._release()
        self._chip = FtdiFifo(self._file.serial)
        self.off(now)

    def busy(self, now: float) -> float:
        """Time until half a modulation period after the last message [s]."""
        return max(0.0, self._free_at - now)

    def emit(self, emission: Emission, now: float) -> float:
        """Send the message, and start modulating."""
        self._message = self.message(emission.drive)
        starts = not self._sounding or not emission.modulated
        self._sounding, self._modulated = True, emission.modulated
        self._free_at = now + _HALF_PERIOD
        self.held = emission.drive
        if starts:
            self._high, self._next_at = True, now + _HALF_PERIOD
        if self._high:
            self._opened.write(self._message)
            return now
        return self._next_at

    def message(self, drive: NDArray[np.complex128]) -> bytes:
        """The message for a drive of shape [T]."""
        adjusted = drive * self._file.amplitude_adjust
        phases, widths = drive_steps(self.array, adjusted)
        # A narrower pulse starts later, so that its center does not move.
        phases = (phases + (WIDTH_STEPS - widths) / 2) % PHASE_STEPS
        data = np.zeros(2 * COUNT, np.uint8)
        data[self._file.pins] = np.where(widths > 0, phases, 0.0)
        data[COUNT + self._file.pins] = widths
        data[0] += _FLAG
        return data.tobytes()

    def off(self, now: float) -> None:
        """Discard the chip's buffers, and send silence."""
        self._sounding = self._high = False
        self._opened.purge()
        self._opened.write(bytes(self._silence) * _OFF_COPIES)
        self._next_at = now + _RENEW
        self.held = np.zeros(COUNT, np.complex128)

    def service(self, now: float) -> float:
        """Continue the modulation, or send silence again in case the board was reset."""
        if now >= self._next_at:
            if self._sounding and self._modulated:
                self._high = not self._high
                # Missed half periods are skipped.
                self._next_at = max(self._next_at + _HALF_PERIOD, now + 0.5 * _HALF_PERIOD)
                self._opened.write(self._message if self._high else bytes(self._silence))
            else:
                # This also checks the connection.
                self._next_at = now + _RENEW
                self._opened.write(self._message if self._sounding else bytes(self._silence) * 2)
        return max(0.0, self._next_at - now)

    def close(self, now: float) -> None:
        """Send silence."""
        if self._chip is not None:
            with contextlib.suppress(DeviceError):
                self.off(now)
        self._release()

    def _release(self) -> None:
        if self._chip is not None:
            self._chip.close()
            self._chip = None

    @property
    def _opened(self) -> FtdiFifo:
        if self._chip is None:
            raise DeviceError("The OpenMPD board is not connected.")
        return self._chip
