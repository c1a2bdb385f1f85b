# SPDX-License-Identifier: GPL-3.0-or-later
"""The speed of a potter's wheel, and the angle that it has turned by.

The speed, ``Object.tactile_clay.wheel_speed``, is what one sets and animates; the angle is its
integral over time. A keyed speed is integrated along its curve, exactly where that is constant or
straight; a driven one, or one that comes from the nonlinear animation editor, is known at whole
frames only, and taken as straight in between.
"""

from __future__ import annotations

import math

import bpy
import numpy as np
from numpy.typing import NDArray

from ..model.properties import MAX_WHEEL_SPEED

SPEED_PATH = "tactile_clay.wheel_speed"
"""Path of the speed [rpm] from its object."""
RATE = 2.0 * math.pi / 60.0
"""Angular velocity at one turn a minute [rad/s]."""

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)


def speed_curve(item: bpy.types.Object) -> bpy.types.FCurve | None:
    """The curve that alone says how fast a wheel turns, if its speed is keyed.

    A curve of the nonlinear animation editor's, or one that is mixed in, is none.
    """
    animation = item.animation_data
    if animation is None or animation.action is None or _is_mixed(animation):
        return None
    for layer in animation.action.layers:
        for strip in layer.strips:
            bag = strip.channelbag(animation.action_slot) if animation.action_slot else None
            curve = bag.fcurves.find(SPEED_PATH) if bag else None
            if curve is not None and not curve.mute and not curve.is_empty:
                return curve
    return None


def is_driven(item: bpy.types.Object) -> bool:
    """Whether only Blender can tell the speed, frame by frame."""
    animation = item.animation_data
    if animation is None:
        return False
    return animation.drivers.find(SPEED_PATH) is not None or _is_mixed(animation)


def _is_mixed(animation: bpy.types.AnimData) -> bool:
    return animation.use_nla and any(
        not track.mute and track.strips for track in animation.nla_tracks
    )


def turns(
    item: bpy.types.Object, times: NDArray[np.float64], frame_duration: float
) -> NDArray[np.float64]:
    """The angle that a wheel, whose speed is not driven, turns by in each frame [rad].

    Args:
        item: The wheel.
        times: Animation times of the frames, evenly spaced, shape [N]; see `animation_time`.
        frame_duration: Time from frame to frame [s].

    Returns:
        From each frame to the next, shape [N - 1].
    """
    curve = speed_curve(item)
    if curve is None:
        return np.full(len(times) - 1, item.tactile_clay.wheel_speed * RATE * frame_duration)
    points = curve.keyframe_points
    keys = np.empty(2 * len(points))
    points.foreach_get("co", keys)
    # Between keys a curve is smooth.
    inner = keys[::2]
    inner = inner[(inner > times[0]) & (inner < times[-1])]
    places = np.union1d(times, inner)
    half = 0.5 * np.diff(places)
    at = (places[:-1] + half)[:, None] + half[:, None] * _NODES
    speeds = np.array([curve.evaluate(place) for place in at.ravel()]).reshape(at.shape)
    # Blender holds an animated property within its limits.
    pieces = half * (limited(speeds) @ _WEIGHTS)
    whole = np.zeros(len(times) - 1)
    np.add.at(whole, np.searchsorted(times, places[:-1] + half) - 1, pieces)
    return whole / (times[1] - times[0]) * RATE * frame_duration


def turns_between(speeds: NDArray[np.float64], frame_duration: float) -> NDArray[np.float64]:
    """The angle that a wheel turns by in each frame [rad], shape [N - 1].

    Args:
        speeds: At whole frames [rpm], shape [N].
        frame_duration: Time from frame to frame [s].
    """
    known = limited(speeds)
    return 0.5 * (known[1:] + known[:-1]) * RATE * frame_duration


def limited(speeds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Speeds as the property takes them [rpm]."""
    return np.clip(np.nan_to_num(speeds), -MAX_WHEEL_SPEED, MAX_WHEEL_SPEED)
