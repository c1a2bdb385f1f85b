# SPDX-License-Identifier: GPL-3.0-or-later
"""Keyframes of ordinary actions: many keys at once, and the curves they make."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import bpy
import numpy as np
from numpy.typing import ArrayLike

INTERPOLATIONS = {"CONSTANT": 0, "LINEAR": 1}
"""Numbers of the interpolations, as keys take them in bulk."""


def curves_of(item: bpy.types.ID) -> Sequence[bpy.types.FCurve]:
    """The curves of an object's own action; none where it has no keys."""
    animation = item.animation_data
    if animation is None or animation.action is None or animation.action_slot is None:
        return []
    for layer in animation.action.layers:
        for strip in layer.strips:
            bag = strip.channelbag(animation.action_slot)
            if bag is not None:
                return list(bag.fcurves)
    return []


def find_curve(item: bpy.types.ID, path: str) -> bpy.types.FCurve | None:
    """The curve of one property of an object; None where it has no keys."""
    for curve in curves_of(item):
        if curve.data_path == path and curve.array_index == 0:
            return curve
    return None


def write_keys(
    item: bpy.types.ID,
    channels: Mapping[str, ArrayLike],
    frames: ArrayLike,
    *,
    interpolation: str = "LINEAR",
) -> None:
    """Give properties of an object a key at each of many frames.

    Args:
        item: The object.
        channels: Values by data path, shape [F] or, for a vector, [F, C].
        frames: Numbers of the frames, in ascending order, shape [F].
        interpolation: ``CONSTANT`` or ``LINEAR``, between the keys.
    """
    numbers = np.asarray(frames, np.float32)
    columns = {}
    for path, given in channels.items():
        values = np.asarray(given, np.float32).reshape(len(numbers), -1)
        # One key makes the channels; the others go in at once, which is a hundred times faster.
        item.keyframe_insert(path, frame=float(numbers[0]))
        columns.update({(path, index): values[:, index] for index in range(values.shape[1])})
    for curve in curves_of(item):
        column = columns.get((curve.data_path, curve.array_index))
        if column is None:
            continue
        points = curve.keyframe_points
        points.add(len(column) - len(points))
        points.foreach_set("co", np.column_stack([numbers, column]).ravel())
        kinds = np.full(len(column), INTERPOLATIONS[interpolation], np.int32)
        points.foreach_set("interpolation", kinds)
        curve.update()
