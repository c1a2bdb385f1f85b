# SPDX-License-Identifier: GPL-3.0-or-later
"""The interface between the array server and a device, and device names on the command line."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ...solver.core.errors import TactileClayError
from ..acoustics.transducer_array import TransducerArray

MODULATION_FREQUENCY = 200.0
"""Frequency at which sound is switched on and off so that it can be felt [Hz]."""


class DeviceError(TactileClayError):
    """A device is missing, does not answer or cannot be used; the message says what to do."""


@dataclass(frozen=True)
class Emission:
    """What a device should emit from now on."""

    positions: NDArray[np.float32]
    """Focal points in the array's frame [m], shape [K, 3]."""
    pressures: NDArray[np.float32]
    """Pressure amplitude at each [Pa], shape [K]."""
    drive: NDArray[np.complex128]
    """The drive that `solve_drive` found, shape [T]; empty if the device takes focal points."""
    modulated: bool = True
    """Whether the sound is switched on and off at `MODULATION_FREQUENCY`."""
    amplitude_cap: float = 1.0
    """Maximum amplitude, 0 to 1; the drive already obeys it."""
    pressure_cap: float = 2000.0
    """Maximum pressure [Pa]; the pressures already obey it."""


@dataclass(frozen=True)
class DeviceName:
    """A device as the user writes it: ``name``, ``name:address`` or ``name:address,key=value,…``.

    Example:
        >>> DeviceName.parse("sonicsurface:/dev/ttyUSB0,firmware=tactile")
        DeviceName(kind='sonicsurface', address='/dev/ttyUSB0', options={'firmware': 'tactile'})
    """

    kind: str
    """One of `DEVICE_KINDS`."""
    address: str = ""
    """Identifies the device among others of its kind, such as a port, a file or a host."""
    options: dict[str, str] = field(default_factory=dict)
    """Further options by key."""

    @classmethod
    def parse(cls, text: str) -> DeviceName:
        """Parse a name.

        Raises:
            DeviceError: The text does not have this form.
        """
        kind, _, rest = text.strip().partition(":")
        address, options = "", {}
        for part in filter(None, rest.split(",")):
            key, equals, value = part.partition("=")
            if equals:
                options[key.strip()] = value.strip()
            elif address or options:
                raise DeviceError(
                    f"{part!r} in {text!r} was not understood. Write NAME:ADDRESS,KEY=VALUE,…"
                )
            else:
                address = part
        if not kind:
            raise DeviceError(f"{text!r} does not name a device. Write NAME:ADDRESS,KEY=VALUE,…")
        return cls(kind, address, options)

    def choice(self, key: str, choices: tuple[str, ...]) -> str:
        """The value of an option; the first choice if it is not given.

        Raises:
            DeviceError: The value is not one of the choices.
        """
        value = self.options.get(key, choices[0])
        if value not in choices:
            raise DeviceError(f"{key} must be {' or '.join(choices)}, not {value!r}.")
        return value

    def number(self, key: str, default: float) -> float:
        """The value of a numeric option.

        Raises:
            DeviceError: The value is not a finite number.
        """
        text = self.options.get(key, str(default))
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise DeviceError(f"{key} must be a number, not {text!r}.")
        return value

    def check_options(self, *known: str) -> None:
        """Refuse unknown options.

        Raises:
            DeviceError: An option is unknown; the message lists the known ones.
        """
        for key in self.options:
            if key not in known:
                raise DeviceError(
                    f"{self.kind} has no option {key!r}. "
                    + (f"Its options are: {', '.join(known)}." if known else "It has none.")
                )


@dataclass(frozen=True)
class FoundDevice:
    """A device that is connected to the computer."""

    name: str
    """Its name as a `DeviceName`."""
    description: str
    """The operating system's description."""


class Device(ABC):
    """An ultrasound array, used by a single thread.

    The device is silent after `open`, whatever it did before, and after `off` and `close`. After a
    `DeviceError` from any method except `open`, its state is unknown until it is opened again.
    """

    array: TransducerArray
    """The transducers in the device's own coordinates, for which `solve_drive` finds a drive."""
    maximum_foci: ClassVar[int] = 32
    """Maximum number of simultaneous focal points."""
    takes_foci: ClassVar[bool] = False
    """Whether the device computes the drive itself from focal points."""
    has_watchdog: ClassVar[bool] = False
    """Whether the device silences itself if the server is gone."""

    held: NDArray[np.complex128] = np.zeros(0, np.complex128)
    """The drive last sent to the device, after quantization, shape [T]; 0 is silence."""

    @abstractmethod
    def open(self, now: float) -> None:
        """Connect to the device and silence it; may be called again after an error.

        Args:
            now: The monotonic clock [s], also in the methods below.

        Raises:
            DeviceError: The device cannot be reached.
        """

    @abstractmethod
    def busy(self, now: float) -> float:
        """Time until the device accepts the next emission [s]; 0 if it accepts one now."""

    @abstractmethod
    def emit(self, emission: Emission, now: float) -> float:
        """Replace the current emission; call it only when not `busy`.

        Args:
            emission: What to emit.
            now: The monotonic clock [s].

        Returns:
            When the emission will start, by the same clock [s].

        Raises:
            DeviceError: The device is gone or does not accept the emission.
        """

    @abstractmethod
    def off(self, now: float) -> None:
        """Silence the device immediately, discarding anything in progress.

        Raises:
            DeviceError: The device is gone or does not accept the command.
        """

    def service(self, now: float) -> float:
        """Do periodic work: modulation by the host, repeated silence, checks of the connection.

        Returns:
            Maximum time until the next call [s].

        Raises:
            DeviceError: The device is gone or does not accept data.
        """
        return math.inf

    @abstractmethod
    def close(self, now: float) -> None:
        """Silence the device if possible, and release it; raises no errors."""
