# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading frames packed in point clouds."""

from __future__ import annotations

import math

import bpy
import numpy as np
from numpy.typing import NDArray

from ..clay.look import get_input

MODIFIER_NAME = "Clay Playback"
FRAME_ATTRIBUTE = ".clay_frame_"
"""Name prefix; the leading dot hides hundreds of attributes from lists in the interface."""


def is_packed(clay: bpy.types.Object) -> bool:
    """Whether an object plays frames packed in the .blend.

    It then needs no cache, and writing to its positions has no visible effect.
    """
    modifier = clay.modifiers.get(MODIFIER_NAME)
    return (
        clay.type == "POINTCLOUD"
        and modifier is not None
        and modifier.type == "NODES"
        and modifier.node_group is not None
        and bool(packed_attributes(clay))
    )


def packed_positions(clay: bpy.types.Object, frame: float) -> NDArray[np.float32]:
    """The positions that a packed object shows at a frame.

    Args:
        clay: An object for which `is_packed` is true.
        frame: Frame number, which may be fractional.

    Returns:
        Positions in the object's coordinates [Blender units], shape [N, 3].
    """
    numbers = [int(name.removeprefix(FRAME_ATTRIBUTE)) for name in packed_attributes(clay)]
    first = min(numbers)
    frame = min(max(frame, first), max(numbers))
    try:
        hold = get_input(clay.modifiers[MODIFIER_NAME], "Hold")
    except KeyError:
        # Packed by a version that could not hold shapes.
        hold = 1
    if hold > 1:
        frame = first + math.floor((frame - first) / hold) * hold
    low, high = (np.empty((len(clay.data.points), 3), np.float32) for _ in range(2))
    for number, values in ((math.floor(frame), low), (math.ceil(frame), high)):
        layer = clay.data.attributes[f"{FRAME_ATTRIBUTE}{number}"]
        layer.data.foreach_get("vector", values.ravel())
    return (high - low) * np.float32(frame - math.floor(frame)) + low


def packed_attributes(clay: bpy.types.Object) -> list[str]:
    """Names of the attributes that hold an object's packed frames."""
    return [item.name for item in clay.data.attributes if item.name.startswith(FRAME_ATTRIBUTE)]
