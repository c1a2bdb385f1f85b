# SPDX-License-Identifier: GPL-3.0-or-later
"""The 1€ filter: smooth where the hand rests, quick where it moves.

After Casiez, Roussel and Vogel, "1€ Filter: A Simple Speed-based Low-pass Filter for Noisy Input in
Interactive Systems", CHI 2012 (10.1145/2207676.2208639). A joint's speed, not that of each axis,
sets its cut-off, so that the result does not depend on how the axes lie; orientations are filtered
by spherical interpolation with their angular speed.
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
    """How strongly a tracker's hands are filtered."""

    cutoff: float
    """Cut-off of a joint at rest [Hz]."""
    speed_slope: float
    """How much a joint's speed raises that [Hz per m/s]."""
    turn_slope: float
    """How much its angular speed raises that of its orientation [Hz per rad/s]."""


SMOOTHING: Mapping[str, Smoothing] = MappingProxyType(
    {
        "unknown": Smoothing(cutoff=2.0, speed_slope=40.0, turn_slope=4.0),
        "leap": Smoothing(cutoff=2.0, speed_slope=80.0, turn_slope=8.0),
        "mediapipe": Smoothing(cutoff=1.0, speed_slope=20.0, turn_slope=2.0),
        "hts": Smoothing(cutoff=1.5, speed_slope=40.0, turn_slope=4.0),
        "openxr": Smoothing(cutoff=1.5, speed_slope=40.0, turn_slope=4.0),
    }
)
"""Strength for each kind of tracker."""

_SPEED_CUTOFF = 1.0
"""Cut-off of the speed itself [Hz], the paper's choice."""


def smoothing_share(cutoff: ArrayLike, step: float) -> Array:
    """Share of a new value that a first-order low-pass takes in.

    Args:
        cutoff: Cut-off [Hz].
        step: Time since the last value [s].
    """
    turn = 2.0 * math.pi * np.asarray(cutoff, np.float64) * step
    return turn / (turn + 1.0)


class HandFilter:
    """Filters the joints of one hand.

    Limitations: it adds delay, at rest up to 1 / (2 pi cutoff), some 80 ms at 2 Hz; in motion a few
    milliseconds. A frame whose time does not advance changes nothing.
    """

    def __init__(self) -> None:
        self._time: int | None = None
        self._positions = self._seen_positions = self._velocities = np.empty(0)
        self._quaternions = self._seen_quaternions = self._turning = np.empty(0)

    def reset(self) -> None:
        """Forget the past: the next frame is taken as it is."""
        self._time = None

    def __call__(
        self, time: int, positions: ArrayLike, quaternions: ArrayLike, smoothing: Smoothing
    ) -> tuple[Array, Array]:
        """Take in a frame.

        Args:
            time: When it was seen [ns].
            positions: Of each joint [m], shape [N, 3].
            quaternions: Of each joint (x, y, z, w), shape [N, 4].
            smoothing: How strongly to filter.

        Returns:
            The filtered positions and quaternions, of the same shapes.
        """
        positions = np.asarray(positions, np.float64)
        quaternions = np.asarray(quaternions, np.float64)
        if self._time is None:
            self._positions, self._quaternions = positions, quaternions
            self._velocities = np.zeros_like(positions)
            self._turning = np.zeros(len(quaternions))
        elif time > self._time:
            step = (time - self._time) * 1e-9
            blend = float(smoothing_share(_SPEED_CUTOFF, step))
            change = (positions - self._seen_positions) / step
            self._velocities = self._velocities + blend * (change - self._velocities)
            speed = np.linalg.norm(self._velocities, axis=1)
            share = smoothing_share(smoothing.cutoff + smoothing.speed_slope * speed, step)
            self._positions = self._positions + share[:, None] * (positions - self._positions)
            turning = angles_between(self._seen_quaternions, quaternions) / step
            self._turning = self._turning + blend * (turning - self._turning)
            share = smoothing_share(smoothing.cutoff + smoothing.turn_slope * self._turning, step)
            self._quaternions = slerp(self._quaternions, quaternions, share)
        else:
            return self._positions, self._quaternions
        self._time = time
        self._seen_positions, self._seen_quaternions = positions, quaternions
        return self._positions, self._quaternions
