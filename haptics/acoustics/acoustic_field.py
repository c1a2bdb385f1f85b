# SPDX-License-Identifier: GPL-3.0-or-later
"""The sound field of an array, each transducer modeled as a baffled piston in its far field."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .transducer_array import TransducerArray

_CHUNK = 1 << 18
"""Pairs of point and transducer computed at once, to bound memory."""


def propagation(array: TransducerArray, points: ArrayLike) -> NDArray[np.complex128]:
    """Complex pressure of each transducer at points, at full drive and phase 0 [Pa], shape [P, T].

    A transducer of radius a gives (p0 / d) (2 J1(ka sin θ) / ka sin θ) e^{i (k d + offset)} at a
    distance d and an angle θ from its normal, and nothing behind its baffle. This is the far-field
    formula; distances below one radius are taken as one radius.

    Args:
        array: The array, placed in the world.
        points: World coordinates [m], shape [P, 3].
    """
    targets = np.asarray(points, np.float64).reshape(-1, 3) - array.position
    sources = array.positions - array.position
    square = (targets * targets).sum(1)[:, None] - 2.0 * (targets @ sources.T)
    square += (sources * sources).sum(1)
    square = np.maximum(square, max(array.radius, 1e-3) ** 2)
    distance = np.sqrt(square)
    height = targets @ array.normals.T - (sources * array.normals).sum(1)
    amplitude = array.p0 / distance
    if array.radius > 0.0:
        sine_square = np.maximum(1.0 - height * height / square, 0.0)
        amplitude *= _piston(sine_square, array.wavenumber * array.radius)
    amplitude *= height >= 0.0
    phase = array.wavenumber * distance + array.phase_offsets
    result = np.empty(phase.shape, np.complex128)
    np.multiply(amplitude, np.cos(phase), out=result.real)
    np.multiply(amplitude, np.sin(phase), out=result.imag)
    return result


def acoustic_field(
    array: TransducerArray, drive: ArrayLike, points: ArrayLike
) -> NDArray[np.complex128]:
    """Complex pressure of a driven array at points [Pa, peak], shape [P].

    Args:
        array: The array, placed in the world.
        drive: Amplitude (0 to 1) and phase of each transducer, shape [T].
        points: World coordinates [m], shape [P, 3].

    Raises:
        ValueError: The drive does not have one entry per transducer.
    """
    targets = np.asarray(points, np.float64).reshape(-1, 3)
    emitted = np.asarray(drive, np.complex128)
    if emitted.shape != (array.count,):
        raise ValueError(f"The drive has shape {emitted.shape}; expected ({array.count},).")
    chunks = max(1, math.ceil(len(targets) * array.count / _CHUNK))
    parts = [propagation(array, part) @ emitted for part in np.array_split(targets, chunks)]
    return np.concatenate(parts)


def _piston(sine_square: NDArray[np.float64], ka: float) -> NDArray[np.float64]:
    """2 J1(x) / x at x = ka sin θ by its power series, accurate to 1e-10 for ka up to 12."""
    quarter = 0.25 * ka * ka
    count = 4
    term = 1.0
    for order in range(1, 80):
        term *= quarter / (order * (order + 1))
        if term < 1e-13:
            count = order
            break
    argument = (-quarter) * sine_square
    result = np.ones_like(argument)
    for order in range(count, 0, -1):
        result *= argument
        result *= 1.0 / (order * (order + 1))
        result += 1.0
    return result
