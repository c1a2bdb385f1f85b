# SPDX-License-Identifier: GPL-3.0-or-later
"""The speed of a potter's wheel, and its integral, the angle.

The user sets or animates the speed, ``Object.tactile_clay.wheel_speed``. A keyframed speed is
integrated along its F-curve, exactly where that is constant or linear. A driven speed, or one from
the Nonlinear Animation editor, is known at whole frames only and is interpolated linearly.
"""

from __future__ import annotations

import math

import bpy
import numpy as np
from numpy.typing import NDArray

from ..model.properties import MAX_WHEEL_SPEED

SPEED_PATH = "tactile_clay.wheel_speed"
"""Data path of the speed [rpm], relative to the object."""
RPM = 2.0 * math.pi / 60.0
"""One revolution per minute [rad/s]."""

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)


def speed_curve(item: bpy.types.Object) -> bpy.types.FCurve | None:
    """The F-curve of a wheel's keyframed speed; None if there is none.

    Also None if the Nonlinear Animation editor affects the object, as the curve alone then does
    not determine the speed.
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
    """Whether the speed is known only after Blender evaluates a frame."""
    animation = item.animation_data
    if animation is None:
        return False
    return animation.drivers.find(SPEED_PATH) is not None or _is_mixed(animation)


def _is_mixed(animation: bpy.types.AnimData) -> bool:
    return animation.use_nla and any(
        not track.mute and track.strips for track in animation.nla_tracks
    )


def frame_turns(
    item: bpy.types.Object, times: NDArray[np.float64], frame_duration: float
) -> NDArray[np.float64]:
    """Angles by which a wheel whose speed is not driven turns in each frame [rad].

    Args:
        item: The wheel.
        times: Animation times of the frames, evenly spaced, shape [N]; see `animation_time`.
        frame_duration: Time from frame to frame [s].

    Returns:
        From each frame to the next, shape [N - 1].
    """
    curve = speed_curve(item)
    if curve is None:
        return np.full(len(times) - 1, item.tactile_clay.wheel_speed * RPM * frame_duration)
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
    pieces = half * (clamped_speeds(speeds) @ _WEIGHTS)
    whole = np.zeros(len(times) - 1)
    np.add.at(whole, np.searchsorted(times, places[:-1] + half) - 1, pieces)
    return whole / (times[1] - times[0]) * RPM * frame_duration


def sampled_frame_turns(speeds: NDArray[np.float64], frame_duration: float) -> NDArray[np.float64]:
    """Angles by which a wheel turns in each frame [rad], shape [N - 1].

    Args:
        speeds: Speeds at whole frames [rpm], shape [N].
        frame_duration: Time from frame to frame [s].
    """
    known = clamped_speeds(speeds)
    return 0.5 * (known[1:] + known[:-1]) * RPM * frame_duration


def clamped_speeds(speeds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Speeds clamped to the property's limits, with NaN replaced by 0 [rpm]."""
    return np.clip(np.nan_to_num(speeds), -MAX_WHEEL_SPEED, MAX_WHEEL_SPEED)
