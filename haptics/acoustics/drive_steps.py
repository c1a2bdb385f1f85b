# SPDX-License-Identifier: GPL-3.0-or-later
"""The phases and amplitudes that a driver board has, and the nearest of them to what is wanted."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .transducer_array import TransducerArray


def realised(array: TransducerArray, drive: ArrayLike) -> NDArray[np.complex128]:
    """Nearest drive that the array can emit, shape [T].

    Args:
        array: Its `phase_steps` and `amplitude_steps` count.
        drive: Amplitude (0 to 1) and phase of each transducer, shape [T]; greater amplitudes are
            taken as 1.
    """
    phases, amplitudes = drive_steps(array, drive)
    size = amplitudes if array.amplitude_steps is None else _levels(array)[amplitudes.astype(int)]
    turn = phases if array.phase_steps is None else phases * (2.0 * math.pi / array.phase_steps)
    return np.asarray(size * np.exp(1j * turn))


def drive_steps(
    array: TransducerArray, drive: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A drive as the numbers that a driver board is told.

    Args:
        array: Its `phase_steps` and `amplitude_steps` count.
        drive: Amplitude (0 to 1) and phase of each transducer, shape [T].

    Returns:
        The phase by which each transducer lags, as a step 0 to phase_steps - 1, or in radians where
        the array has no steps, shape [T]; and the step of its amplitude, 0 to amplitude_steps, or
        the amplitude itself, shape [T].
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
    """Amplitudes of the steps from 0 to the last, shape [N + 1]."""
    assert array.amplitude_steps is not None
    part = np.arange(array.amplitude_steps + 1) / array.amplitude_steps
    return part if array.amplitude_law == "linear" else np.sin(0.5 * math.pi * part)
