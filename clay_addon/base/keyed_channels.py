# SPDX-License-Identifier: GPL-3.0-or-later
"""Writing keyframes in bulk, as a new action for each object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

CONSTANT, LINEAR = 0, 1
"""Blender's integer codes for the interpolation between two keyframes."""


@dataclass(frozen=True)
class Channel:
    """One animated number of an object."""

    path: str
    """Blender data path, relative to the object."""
    index: int
    """Component of a vector or quaternion; 0 otherwise."""
    frames: NDArray[Any]
    """Frames of the keys, ascending, not necessarily whole, shape [K]."""
    values: NDArray[Any]
    """Values at the keys, shape [K]."""
    interpolation: int = LINEAR
    """`LINEAR` or `CONSTANT`."""
    group: str = ""
    """Name of the channel group, such as the bone."""


def write_channels(item: bpy.types.ID, name: str, channels: Sequence[Channel]) -> None:
    """Give an object a new action with some channels; its previous action stays in the file.

    Args:
        item: The object, or another data-block that can be animated.
        name: Name of the action.
        channels: The channels, with at least one key each.
    """
    animation = item.animation_data or item.animation_data_create()
    if animation.action is not None:
        animation.action.use_fake_user = True
    action = bpy.data.actions.new(name)
    slot = action.slots.new(id_type=item.id_type, name=item.name)
    strip = action.layers.new("Layer").strips.new(type="KEYFRAME")
    bag = strip.channelbag(slot, ensure=True)
    animation.action = action
    animation.action_slot = slot
    for channel in channels:
        curve = bag.fcurves.new(channel.path, index=channel.index)
        if channel.group:
            curve.group = bag.groups.get(channel.group) or bag.groups.new(channel.group)
        points = curve.keyframe_points
        points.add(len(channel.values))
        table = np.column_stack([channel.frames, channel.values]).astype(np.float32)
        points.foreach_set("co", table.ravel())
        kinds = np.full(len(channel.values), channel.interpolation, np.int32)
        points.foreach_set("interpolation", kinds)
        curve.update()
    item.update_tag()


def find_curve(item: bpy.types.ID, path: str) -> bpy.types.FCurve | None:
    """The first F-curve of a property in an object's own action; None if it has no keys."""
    animation = item.animation_data
    if animation is None or animation.action is None or animation.action_slot is None:
        return None
    for layer in animation.action.layers:
        for strip in layer.strips:
            bag = strip.channelbag(animation.action_slot)
            for curve in bag.fcurves if bag is not None else ():
                if curve.data_path == path:
                    return curve
    return None


def significant_keys(values: NDArray[Any]) -> NDArray[np.bool_]:
    """Mask of the keys to keep, shape [K]; drops keys whose two neighbors have the same value."""
    same = values[1:] == values[:-1]
    kept = np.ones(len(values), bool)
    kept[1:-1] = ~(same[:-1] & same[1:])
    if same.all():
        kept[1:] = False
    return kept
