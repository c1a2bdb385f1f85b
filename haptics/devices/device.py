# SPDX-License-Identifier: GPL-3.0-or-later
"""What every array device is to the array server, and how it is named on the command line."""

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
"""Frequency at which sound goes on and off so that it is felt [Hz]."""


class DeviceError(TactileClayError):
    """A device is not there, does not answer or cannot be used so; the message says what to do."""


@dataclass(frozen=True)
class Emission:
    """What a device shall emit from now on."""

    positions: NDArray[np.float32]
    """Focal points in the array's frame [m], shape [K, 3]."""
    pressures: NDArray[np.float32]
    """Pressure amplitude at each [Pa], shape [K]."""
    drive: NDArray[np.complex128]
    """What `solve_drive` found for them, shape [T]; empty if the device takes focal points."""
    modulated: bool = True
    """Whether it goes on and off at `MODULATION_FREQUENCY`."""
    amplitude_cap: float = 1.0
    """Highest amplitude, 0 to 1, which the drive obeys already."""
    pressure_cap: float = 2000.0
    """Highest pressure [Pa], which the pressures obey already."""


@dataclass(frozen=True)
class DeviceName:
    """A device as people write it: ``name``, ``name:address`` or ``name:address,key=value,…``.

    Example:
        >>> DeviceName.parse("sonicsurface:/dev/ttyUSB0,firmware=tactile")
        DeviceName(kind='sonicsurface', address='/dev/ttyUSB0', options={'firmware': 'tactile'})
    """

    kind: str
    """Which kind of device."""
    address: str = ""
    """Which one of that kind: a port, a serial number, a host."""
    options: dict[str, str] = field(default_factory=dict)
    """What else is to be known about it."""

    @classmethod
    def parse(cls, text: str) -> DeviceName:
        """Read a name.

        Raises:
            DeviceError: It has not that form.
        """
        kind, _, rest = text.strip().partition(":")
        address, options = "", {}
        for part in filter(None, rest.split(",")):
            key, equals, value = part.partition("=")
            if equals:
                options[key.strip()] = value.strip()
            elif address or options:
                raise DeviceError(
                    f"{part!r} in {text!r} is not understood. Write NAME:ADDRESS,KEY=VALUE,…"
                )
            else:
                address = part
        if not kind:
            raise DeviceError(f"{text!r} names no device. Write NAME:ADDRESS,KEY=VALUE,…")
        return cls(kind, address, options)

    def choice(self, key: str, choices: tuple[str, ...]) -> str:
        """The value of an option, the first choice where it is not given.

        Raises:
            DeviceError: It is not one of the choices.
        """
        value = self.options.get(key, choices[0])
        if value not in choices:
            raise DeviceError(f"{key} must be {' or '.join(choices)}, not {value!r}.")
        return value

    def number(self, key: str, default: float) -> float:
        """The value of an option that is a number.

        Raises:
            DeviceError: It is not a finite number.
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
        """Refuse options that the device does not know.

        Raises:
            DeviceError: There is one; the message names those there are.
        """
        for key in self.options:
            if key not in known:
                raise DeviceError(
                    f"{self.kind} has no option {key!r}. "
                    + (f"It has: {', '.join(known)}." if known else "It has none.")
                )


@dataclass(frozen=True)
class FoundDevice:
    """A device that is plugged in."""

    name: str
    """As `DeviceName` reads it."""
    description: str
    """What the system says about it."""


class Device(ABC):
    """An ultrasound array, used by one thread.

    Sound off is its resting state: `open` ends with silence, whatever the array did before, and so
    do `off` and `close`. After any `DeviceError` but those of `open`, what the array does is
    unknown until it is opened again.
    """

    array: TransducerArray
    """Its transducers, in its own coordinates; what they emit is a `solve_drive` of this."""
    maximum_foci: ClassVar[int] = 32
    """Most focal points at a time."""
    takes_foci: ClassVar[bool] = False
    """Whether it computes its drive itself, from focal points."""
    has_watchdog: ClassVar[bool] = False
    """Whether it falls silent by itself when the server is gone."""

    held: NDArray[np.complex128] = np.zeros(0, np.complex128)
    """The drive that it holds as far as is known, after quantization, shape [T]; 0 is silence."""

    @abstractmethod
    def open(self, now: float) -> None:
        """Connect and make silent; may be called again after an error.

        Args:
            now: The monotonic clock [s], here and below.

        Raises:
            DeviceError: It cannot be reached.
        """

    @abstractmethod
    def busy(self, now: float) -> float:
        """How long until it takes the next emission [s], 0 if at once."""

    @abstractmethod
    def emit(self, emission: Emission, now: float) -> float:
        """Emit from now on, instead of what was emitted before; call it when not `busy`.

        Args:
            emission: What.
            now: The monotonic clock [s].

        Returns:
            When it will sound, by the same clock [s].

        Raises:
            DeviceError: It is gone or does not take it.
        """

    @abstractmethod
    def off(self, now: float) -> None:
        """Be silent, at once and whatever is under way.

        Raises:
            DeviceError: It is gone or does not take it.
        """

    def service(self, now: float) -> float:
        """Do what is due: modulation from the host, repeated silence, a look at the connection.

        Returns:
            When to call it again at the latest [s from now].

        Raises:
            DeviceError: It is gone or does not take it.
        """
        return math.inf

    @abstractmethod
    def close(self, now: float) -> None:
        """Make silent if that is possible, and let go of it; raises nothing."""
