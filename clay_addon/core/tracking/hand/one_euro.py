# SPDX-License-Identifier: GPL-3.0-or-later
"""The 1€ filter: strong smoothing at rest, little delay in motion.

After Casiez, Roussel and Vogel, "1€ Filter: A Simple Speed-based Low-pass Filter for Noisy Input in
Interactive Systems", CHI 2012 (10.1145/2207676.2208639). The cut-off depends on a joint's speed
rather than on the speed along each axis, so that the result does not depend on the choice of axes.
Orientations are filtered by spherical interpolation, with a cut-off from their angular speed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .....solver.geometry.rotations import angles_between, slerp

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Smoothing:
    """Filter parameters for one kind of tracker."""

    cutoff: float
    """Cut-off frequency of a joint at rest [Hz]."""
    speed_slope: float
    """Increase of the position's cut-off with the joint's speed [Hz per m/s]."""
    turn_slope: float
    """Increase of the orientation's cut-off with the joint's angular speed [Hz per rad/s]."""


SMOOTHING: Mapping[str, Smoothing] = MappingProxyType(
    {
        "unknown": Smoothing(cutoff=2.0, speed_slope=40.0, turn_slope=4.0),
        "leap": Smoothing(cutoff=2.0, speed_slope=80.0, turn_slope=8.0),
        "mediapipe": Smoothing(cutoff=1.0, speed_slope=20.0, turn_slope=2.0),
        "hts": Smoothing(cutoff=1.5, speed_slope=40.0, turn_slope=4.0),
        "openxr": Smoothing(cutoff=1.5, speed_slope=40.0, turn_slope=4.0),
    }
)
"""Parameters for each kind of tracker."""

_SPEED_CUTOFF = 1.0
"""Cut-off of the low-pass on speeds [Hz], as in the paper."""


def smoothing_share(cutoff: ArrayLike, step: float) -> Array:
    """Weight of the new value in a first-order low-pass.

    Args:
        cutoff: Cut-off frequency [Hz].
        step: Time since the last value [s].
    """
    phase = 2.0 * math.pi * np.asarray(cutoff, np.float64) * step
    return phase / (phase + 1.0)


class HandFilter:
    """Filters the joints of one hand.

    Limitations: it adds delay, up to 1 / (2 pi cutoff) at rest (80 ms at 2 Hz) and a few
    milliseconds in motion. A frame whose time does not advance is ignored.
    """

    def __init__(self) -> None:
        self._time: int | None = None
        self._positions = self._raw_positions = self._velocities = np.empty(0)
        self._quaternions = self._raw_quaternions = self._angular_speeds = np.empty(0)

    def reset(self) -> None:
        """Clear the history; the next frame passes unfiltered."""
        self._time = None

    def __call__(
        self, time: int, positions: ArrayLike, quaternions: ArrayLike, smoothing: Smoothing
    ) -> tuple[Array, Array]:
        """Filter a frame.

        Args:
            time: When the hand was seen [ns].
            positions: Position of each joint [m], shape [N, 3].
            quaternions: Orientation of each joint (x, y, z, w), shape [N, 4].
            smoothing: Filter parameters.

        Returns:
            The filtered positions and quaternions, with the same shapes.
        """
        positions = np.asarray(positions, np.float64)
        quaternions = np.asarray(quaternions, np.float64)
        if self._time is None:
            self._positions, self._quaternions = positions, quaternions
            self._velocities = np.zeros_like(positions)
            self._angular_speeds = np.zeros(len(quaternions))
        elif time > self._time:
            step = (time - self._time) * 1e-9
            blend = float(smoothing_share(_SPEED_CUTOFF, step))
            velocities = (positions - self._raw_positions) / step
            self._velocities = self._velocities + blend * (velocities - self._velocities)
            speeds = np.linalg.norm(self._velocities, axis=1)
            share = smoothing_share(smoothing.cutoff + smoothing.speed_slope * speeds, step)
            self._positions = self._positions + share[:, None] * (positions - self._positions)
            turning = angles_between(self._raw_quaternions, quaternions) / step
            speeds = self._angular_speeds + blend * (turning - self._angular_speeds)
            share = smoothing_share(smoothing.cutoff + smoothing.turn_slope * speeds, step)
            self._quaternions = slerp(self._quaternions, quaternions, share)
            self._angular_speeds = speeds
        else:
            return self._positions, self._quaternions
        self._time = time
        self._raw_positions, self._raw_quaternions = positions, quaternions
        return self._positions, self._quaternions
