# SPDX-License-Identifier: GPL-3.0-or-later
"""Pressure of an array's sound on a plane, and colors to show it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .acoustic_field import acoustic_field
from .transducer_array import TransducerArray

_RAMP = np.array(
    (
        (0.00, 0.02, 0.01, 0.08),
        (0.25, 0.25, 0.05, 0.42),
        (0.50, 0.72, 0.15, 0.35),
        (0.75, 0.97, 0.50, 0.10),
        (1.00, 1.00, 0.98, 0.65),
    )
)
"""Value, red, green, blue: brightness rises evenly, so it works for color-blind people too."""


def palm_plane(
    points: ArrayLike, pressures: ArrayLike, away: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit a plane to pressed skin.

    Args:
        points: Skin points or focal points [m], shape [P, 3].
        pressures: Pressure at each, used as its weight, shape [P].
        away: Direction out of the array, shape [3]; the normal if the points span no plane.

    Returns:
        The center of the plane [m], shape [3], and its axes as columns: right, up and the normal
        that points away from the array, shape [3, 3].
    """
    skin = np.asarray(points, np.float64).reshape(-1, 3)
    weight = np.asarray(pressures, np.float64).reshape(-1)
    normal = np.asarray(away, np.float64) / np.linalg.norm(away)
    if weight.sum() <= 0.0:
        weight = np.ones(len(skin))
    middle = np.average(skin, axis=0, weights=weight)
    offset = (skin - middle) * np.sqrt(weight / weight.sum())[:, None]
    _, spread, axes = np.linalg.svd(offset, full_matrices=True)
    if len(spread) == 3 and spread[1] > 1e-3 and spread[2] < 0.5 * spread[1]:
        normal = axes[2] * np.sign(axes[2] @ normal or 1.0)
    seed = np.eye(3)[0 if abs(normal[0]) < 0.9 else 1]
    right = seed - (seed @ normal) * normal
    right /= np.linalg.norm(right)
    return middle, np.column_stack((right, np.cross(normal, right), normal))


def field_on_plane(
    array: TransducerArray,
    drive: ArrayLike,
    middle: ArrayLike,
    axes: ArrayLike,
    *,
    size: float = 0.16,
    count: int = 128,
) -> NDArray[np.float64]:
    """Pressure amplitude on a square [Pa], shape [count, count], bottom row first.

    Args:
        array: The array, placed in the world.
        drive: Amplitude and phase of each transducer, shape [T].
        middle: Center of the square [m], shape [3].
        axes: Its axes as columns, right and up first, shape [3, 3].
        size: Edge length [m].
        count: Points along an edge.
    """
    steps = ((np.arange(count) + 0.5) / count - 0.5) * size
    right, up = np.asarray(axes, np.float64).T[:2]
    points = np.asarray(middle) + steps[:, None, None] * up + steps[None, :, None] * right
    values = np.abs(acoustic_field(array, drive, points.reshape(-1, 3)))
    return np.asarray(values.reshape(count, count))


def pressure_colors(pressures: ArrayLike, largest: float) -> NDArray[np.float32]:
    """Colors from dark (0) to bright (`largest` or more), linear RGBA, shape [..., 4].

    Args:
        pressures: Pressures, any shape.
        largest: Pressure of the brightest color, in the same unit.
    """
    value = np.clip(np.asarray(pressures, np.float64) / max(largest, 1e-30), 0.0, 1.0)
    colors = [np.interp(value, _RAMP[:, 0], _RAMP[:, channel]) for channel in (1, 2, 3)]
    return np.stack((*colors, np.ones_like(value)), axis=-1).astype(np.float32)
