# SPDX-License-Identifier: GPL-3.0-or-later
"""Quantizes a drive to the phases and amplitudes of a driver board."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .transducer_array import TransducerArray


def quantized(array: TransducerArray, drive: ArrayLike) -> NDArray[np.complex128]:
    """Nearest drive that the array can emit, shape [T].

    Args:
        array: Gives `phase_steps` and `amplitude_steps`.
        drive: Amplitude (0 to 1) and phase of each transducer, shape [T]; amplitudes above 1 are
            taken as 1.
    """
    phases, amplitudes = drive_steps(array, drive)
    if array.amplitude_steps is not None:
        amplitudes = _levels(array)[amplitudes.astype(int)]
    if array.phase_steps is not None:
        phases = phases * (2.0 * math.pi / array.phase_steps)
    return np.asarray(amplitudes * np.exp(1j * phases))


def drive_steps(
    array: TransducerArray, drive: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Convert a drive to the step numbers of a driver board.

    Args:
        array: Gives `phase_steps` and `amplitude_steps`.
        drive: Amplitude (0 to 1) and phase of each transducer, shape [T].

    Returns:
        The phase lag of each transducer, as a step from 0 to phase_steps - 1, or in radians if the
        array has no phase steps, shape [T]; and its amplitude, as a step from 0 to amplitude_steps,
        or from 0 to 1 if the array has no amplitude steps, shape [T].
    """
    wanted = np.asarray(drive, np.complex128)
    phases = np.angle(wanted) % (2.0 * math.pi)
    amplitudes = np.minimum(np.abs(wanted), 1.0)
    if array.phase_steps is not None:
        phases = np.rint(phases * (array.phase_steps / (2.0 * math.pi))) % array.phase_steps
    if array.amplitude_steps is not None:
        levels = _levels(array)
        amplitudes = np.searchsorted(0.5 * (levels[1:] + levels[:-1]), amplitudes).astype(float)
    return phases, amplitudes


def _levels(array: TransducerArray) -> NDArray[np.float64]:
    """Amplitude of each step from 0 to N, shape [N + 1]."""
    assert array.amplitude_steps is not None
    fraction = np.arange(array.amplitude_steps + 1) / array.amplitude_steps
    return fraction if array.amplitude_law == "linear" else np.sin(0.5 * math.pi * fraction)
