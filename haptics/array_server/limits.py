# SPDX-License-Identifier: GPL-3.0-or-later
"""Safety limits that no message can lift: which focal points are admitted, how strong, how long.

Guidelines on airborne ultrasound (75 dB below 20 kHz, 110 dB at 25 to 50 kHz) lack a solid basis,
and commercial devices were measured above them (10.24425/aoa.2024.148795). Pressure, drive and time
are therefore always capped. The caps are engineering choices, not a medical clearance.
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
"""The array is silenced when the newest focal points are older than this [s]."""
_CLOCK_SLACK = 0.005
"""Maximum time that a datagram may be ahead of the clock [s]."""


@dataclass(frozen=True)
class Limits:
    """Caps of a server; they can only be lower than the defaults.

    Raises:
        ValueError: A value is out of the range given below.
    """

    amplitude: float = 1.0
    """Maximum drive of a transducer relative to full drive, above 0 and up to 1."""
    pressure: float = 2000.0
    """Maximum pressure amplitude at a focal point [Pa], above 0 and up to 2,000."""
    on_time: float = 120.0
    """Maximum time of sound without a pause [s], above 0 and up to 120; see `OnTime`."""

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
    """A datagram is rejected; the message says why."""


class Gate:
    """Admits datagrams that are valid, in order, recent and of this session, and caps them.

    Args:
        array: The array in its own coordinates; focal points must lie in its working volume.
        limits: The caps.
        session: Number of the session to accept.
        maximum_foci: Maximum number of focal points of the device; the strongest are kept.
    """

    def __init__(
        self, array: TransducerArray, limits: Limits, *, session: int, maximum_foci: int
    ) -> None:
        self.array = array
        self.limits = limits
        self.session = session
        self.maximum_foci = maximum_foci
        self.outside = 0
        """Number of focal points left out so far because they were outside the working volume."""
        self._sequence = -1

    def admit(self, data: bytes, now: float) -> Datagram:
        """Admit or reject a datagram.

        Args:
            data: The bytes received.
            now: The monotonic clock [s].

        Returns:
            The datagram without focal points outside the working volume, with pressures capped.

        Raises:
            RefusedError: The datagram is rejected.
        """
        try:
            datagram = decode(data)
        except DatagramError as error:
            raise RefusedError(str(error)) from error
        if datagram.session != self.session:
            raise RefusedError("wrong session")
        if datagram.kind in (Kind.STATUS, Kind.DRIVE):
            raise RefusedError("meant for clients")
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
            raise RefusedError("negative pressure")
        inside = self.array.reaches(positions)
        self.outside += int((~inside).sum())
        kept = np.flatnonzero(inside & (pressures > 0.0))
        if len(kept) > self.maximum_foci:
            strongest = np.argsort(-pressures[kept], kind="stable")[: self.maximum_foci]
            kept = np.sort(kept[strongest])
        return replace(
            datagram,
            positions=positions[kept],
            pressures=np.minimum(pressures[kept], np.float32(self.limits.pressure)),
        )


def cap_drive(
    array: TransducerArray, drive: NDArray[np.complexfloating], limit: float
) -> NDArray[np.complex128]:
    """Cap the amplitudes of a drive, or their mean if transducers are only on or off.

    Args:
        array: The array.
        drive: Complex amplitudes with magnitude 0 to 1, shape [T].
        limit: Maximum amplitude, above 0 and up to 1.

    Returns:
        A drive that the array can emit, with the same phases.

    Raises:
        ValueError: The drive is not finite or does not belong to this array.
    """
    if drive.shape != (array.count,) or not np.isfinite(drive).all():
        raise ValueError("the drive is not finite or does not belong to this array")
    amplitude = np.abs(drive)
    if array.amplitude_steps == 1:
        on = np.flatnonzero(amplitude > 0.0)
        max_on = int(limit * array.count)
        capped = np.zeros(array.count, np.complex128)
        # The transducers that stay on are evenly spread among those that were on.
        kept = on if len(on) <= max_on else on[np.linspace(0, len(on) - 1, max_on).astype(int)]
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
    """Accumulates time of sound, and demands a pause at the limit.

    Sound adds to the total and silence subtracts from it at the same rate, so in the long run there
    is sound at most half of the time. When the total reaches the limit, a pause of at least a
    twelfth of the limit follows (ten seconds by default).
    """

    def __init__(self, limit: float) -> None:
        self.limit = limit
        self.spent = 0.0
        """Time of sound not yet compensated by silence [s]."""
        self._resting = False
        self._time: float | None = None

    def advance(self, now: float, *, emitting: bool) -> None:
        """Add the time since the last call.

        Args:
            now: The monotonic clock [s].
            emitting: Whether there was sound since the last call.
        """
        # At most a second counts: while the computer slept, it is unknown whether there was sound.
        elapsed = 0.0 if self._time is None else min(1.0, max(0.0, now - self._time))
        self._time = now
        self.spent = max(0.0, self.spent + (elapsed if emitting else -elapsed))
        if self.spent >= self.limit:
            self._resting = True
        elif self.spent <= self.limit * (11.0 / 12.0):
            self._resting = False

    @property
    def allowed(self) -> bool:
        """Whether sound is allowed now."""
        return not self._resting

    @property
    def left(self) -> float:
        """Time of sound left before a pause [s]."""
        return 0.0 if self._resting else max(0.0, self.limit - self.spent)
