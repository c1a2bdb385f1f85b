# SPDX-License-Identifier: GPL-3.0-or-later
"""A simulated device that stores its drive and is as slow as the real one."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..acoustics.acoustic_field import acoustic_field
from ..acoustics.transducer_array import TransducerArray
from .device import Device, DeviceError, DeviceName, Emission

_FRAME_SECONDS = {
    "autd3": 0.002,
    "openmpd": 0.0025,
    "sonicsurface": 258 * 10 / 230400,
    "stratos_explore": 0.010,
    "ultraino": 200 * 10 / 115200,
}
"""How long a device is busy with a frame [s]; see the device of that name."""


class DeviceSimulated(Device):
    """``simulated`` or ``simulated:PRESET``: a preset array, by default the SonicSurface."""

    def __init__(self, name: DeviceName) -> None:
        name.check_options()
        preset = name.address or "sonicsurface"
        try:
            self.array = TransducerArray.preset(preset)
        except ValueError as error:
            raise DeviceError(str(error)) from error
        self._frame_seconds = _FRAME_SECONDS.get(preset, 0.010)
        self._free_at = 0.0

    def open(self, now: float) -> None:
        """Store silence."""
        self.held = np.zeros(self.array.count, np.complex128)

    def busy(self, now: float) -> float:
        """Time until the real array would have received the last frame [s]."""
        return max(0.0, self._free_at - now)

    def emit(self, emission: Emission, now: float) -> float:
        """Store the drive."""
        self.held = emission.drive
        self._free_at = now + self._frame_seconds
        return self._free_at

    def off(self, now: float) -> None:
        """Store silence."""
        self.held = np.zeros(self.array.count, np.complex128)

    def close(self, now: float) -> None:
        """Store silence."""
        self.held = np.zeros(self.array.count, np.complex128)

    def field(self, points: ArrayLike) -> NDArray[np.complex128]:
        """The sound field of the stored drive [Pa], shape [P]; see `acoustic_field`.

        Args:
            points: Points in the array's own coordinates [m], shape [P, 3].
        """
        return acoustic_field(self.array, self.held, points)
