# SPDX-License-Identifier: GPL-3.0-or-later
"""What no message can lift: which focal points are let through, how loud and for how long.

Guidelines on airborne ultrasound (75 dB below 20 kHz, 110 dB at 25 to 50 kHz) lack a solid basis,
and commercial devices were measured above them (10.24425/aoa.2024.148795). So pressure, drive and
time are capped whatever is asked for. These caps are engineering choices, not a medical clearance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...solver.core.errors import TactileClayError
from ..acoustics.transducer_array import TransducerArray
from ..protocol.datagram import Datagram, DatagramError, Kind, decode

STALE_AFTER = 0.150
"""Sound goes off when the newest focal points are older than this [s]."""
_CLOCK_SLACK = 0.005
"""A datagram may seem to come from the future by no more than this [s]."""


@dataclass(frozen=True)
class Limits:
    """Caps that a server is started with; a person may only lower them.

    Raises:
        ValueError: A value is out of the range that its line below gives.
    """

    amplitude: float = 1.0
    """Highest drive of a transducer, relative to the device's full drive, above 0 and up to 1."""
    pressure: float = 2000.0
    """Highest pressure amplitude at a focal point [Pa], above 0 and up to 2,000."""
    on_time: float = 120.0
    """Sound without a pause lasts no longer than this [s], above 0 and up to 120: see `OnTime`."""

    def __post_init__(self) -> None:
        """Check the values."""
        for name, value, highest in (
            ("amplitude cap", self.amplitude, 1.0),
            ("pressure cap", self.pressure, 2000.0),
            ("on-time limit", self.on_time, 120.0),
        ):
            if not (0.0 < value <= highest):
                raise ValueError(f"the {name} must be above 0 and at most {highest:g}, not {value}")


class RefusedError(TactileClayError):
    """A datagram is not let through; the message says why."""


class Gate:
    """Lets datagrams through that are whole, in order, fresh and of this session, and caps them.

    Args:
        array: In its own coordinates; focal points must lie in its working volume.
        limits: The caps.
        session: Number of the session that is listened to.
        maximum_foci: Most focal points that the device takes; of more the strongest are let
        through.
    """

    def __init__(
        self, array: TransducerArray, limits: Limits, *, session: int, maximum_foci: int
    ) -> None:
        self.array = array
        self.limits = limits
        self.session = session
        self.maximum_foci = maximum_foci
        self.outside = 0
        """Focal points left out so far because they lay outside the volume."""
        self._sequence = -1

    def admit(self, data: bytes, now: float) -> Datagram:
        """Let a datagram through, or refuse it.

        Args:
            data: What came.
            now: The monotonic clock [s].

        Returns:
            The datagram, with no focal point outside the volume or above the cap.

        Raises:
            RefusedError: It is not let through.
        """
        try:
            datagram = decode(data)
        except DatagramError as error:
            raise RefusedError(str(error)) from error
        if datagram.session != self.session:
            raise RefusedError("of another session")
        if datagram.kind in (Kind.STATUS, Kind.DRIVE):
            raise RefusedError("that is for clients")
        age = now - datagram.time
        if not -_CLOCK_SLACK <= age <= STALE_AFTER:
            raise RefusedError("too old" if age > 0.0 else "from the future")
        if datagram.sequence <= self._sequence:
            raise RefusedError("out of order")
        if datagram.kind is Kind.FOCI:
            datagram = self._capped(datagram)
        self._sequence = datagram.sequence
        return datagram

    def _capped(self, datagram: Datagram) -> Datagram:
        positions, pressures = datagram.positions, datagram.pressures
        if not (np.isfinite(positions).all() and np.isfinite(pressures).all()):
            raise RefusedError("not finite")
        if (pressures < 0.0).any():
            raise RefusedError("a negative pressure")
        inside = self.array.reaches(positions)
        self.outside += int((~inside).sum())
        wanted = np.flatnonzero(inside & (pressures > 0.0))
        if len(wanted) > self.maximum_foci:
            strongest = np.argsort(-pressures[wanted], kind="stable")[: self.maximum_foci]
            wanted = np.sort(wanted[strongest])
        return replace(
            datagram,
            positions=positions[wanted],
            pressures=np.minimum(pressures[wanted], np.float32(self.limits.pressure)),
        )


def cap_drive(
    array: TransducerArray, drive: NDArray[np.complexfloating], limit: float
) -> NDArray[np.complex128]:
    """A drive of which no amplitude, or for transducers without amplitudes not the mean, is above
    a cap.

    Args:
        array: Whose drive it is.
        drive: Complex amplitudes in 0 to 1, shape [T].
        limit: The highest amplitude, above 0 and up to 1.

    Returns:
        A drive that the array has, with the phases kept.

    Raises:
        ValueError: The drive is not finite, or not of this array.
    """
    if drive.shape != (array.count,) or not np.isfinite(drive).all():
        raise ValueError("the drive is not finite, or not of this array")
    amplitude = np.abs(drive)
    if array.amplitude_steps == 1:
        on = np.flatnonzero(amplitude > 0.0)
        most = int(limit * array.count)
        capped = np.zeros(array.count, np.complex128)
        # Those that stay on are spread over all that were.
        kept = on if len(on) <= most else on[np.linspace(0, len(on) - 1, most).astype(int)]
        capped[kept] = drive[kept] / amplitude[kept]
        return capped
    highest = limit
    if array.amplitude_steps is not None:
        steps = array.amplitude_steps
        highest = math.sin(
            math.pi / (2 * steps) * math.floor(2 * steps / math.pi * math.asin(limit) + 1e-9)
        )
    scale = np.minimum(1.0, highest / np.maximum(amplitude, 1e-30))
    return np.asarray(drive * scale, np.complex128)


class OnTime:
    """Counts sound, and asks for a pause.

    Sound adds to the count and silence takes away as much, so over a long time at most half of it
    is sound; when the count reaches the limit there is silence for at least a twelfth of it (ten
    seconds at the default).
    """

    def __init__(self, limit: float) -> None:
        self.limit = limit
        self.spent = 0.0
        """Sound that has not been paused for [s]."""
        self._resting = False
        self._time: float | None = None

    def advance(self, now: float, *, emitting: bool) -> None:
        """Count up to now.

        Args:
            now: The monotonic clock [s].
            emitting: Whether there was sound since the last call.
        """
        # A machine that slept counts for a second: nobody knows whether there was sound.
        passed = 0.0 if self._time is None else min(1.0, max(0.0, now - self._time))
        self._time = now
        self.spent = max(0.0, self.spent + (passed if emitting else -passed))
        if self.spent >= self.limit:
            self._resting = True
        elif self.spent <= self.limit * (11.0 / 12.0):
            self._resting = False

    @property
    def allowed(self) -> bool:
        """Whether there may be sound."""
        return not self._resting

    @property
    def left(self) -> float:
        """Sound that is left [s]."""
        return 0.0 if self._resting else max(0.0, self.limit - self.spent)
