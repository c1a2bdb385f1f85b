# SPDX-License-Identifier: GPL-3.0-or-later
"""Joint positions of a hand in a pose: forward kinematics from joint angles.

Frame: the wrist joint is the origin, straight fingers point to +Y, the back of the hand to +Z, and
the thumb of a right hand to -X.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from .proportions import (
    AVERAGE,
    JOINT_NAMES,
    REFERENCE_LENGTH,
    SEGMENTS,
    THUMB_SEGMENTS,
    HandProportions,
)

Array = NDArray[np.float64]

_THUMB_DIRECTION = (-0.64, 0.70, -0.32)
_THUMB_NAIL = (-0.62, -0.28, 0.73)


@dataclass(frozen=True)
class HandPose:
    """Joint angles of a hand [degrees].

    Flexion bends towards the palm. Spread rotates a finger sideways, away from the middle finger
    if it is negative for the index finger, and positive for the ring and little fingers.
    """

    index: tuple[float, float, float, float] = (-5.0, 0.0, 0.0, 0.0)
    """Spread of the finger, then flexion of its knuckle and its two finger joints."""
    middle: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """As for the index finger."""
    ring: tuple[float, float, float, float] = (5.0, 0.0, 0.0, 0.0)
    """As for the index finger."""
    little: tuple[float, float, float, float] = (12.0, 0.0, 0.0, 0.0)
    """As for the index finger."""
    thumb: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """At its base: flexion across the palm, lift out of the palm's plane, and roll towards the
    fingers; then flexion of its two joints."""


POSES: Mapping[str, HandPose] = MappingProxyType(
    {
        "flat": HandPose(
            index=(-5.0, 0.0, 2.0, 2.0),
            middle=(0.0, 0.0, 2.0, 2.0),
            ring=(5.0, 0.0, 2.0, 2.0),
            little=(12.0, 0.0, 2.0, 2.0),
            thumb=(0.0, 0.0, 0.0, 8.0, 4.0),
        ),
        "relaxed": HandPose(
            index=(-4.0, 20.0, 26.0, 14.0),
            middle=(0.0, 25.0, 30.0, 16.0),
            ring=(4.0, 29.0, 33.0, 18.0),
            little=(9.0, 32.0, 34.0, 18.0),
            thumb=(10.0, 10.0, 10.0, 14.0, 18.0),
        ),
        "point": HandPose(
            index=(-2.0, 6.0, 6.0, 4.0),
            middle=(0.0, 74.0, 90.0, 38.0),
            ring=(2.0, 77.0, 90.0, 38.0),
            little=(4.0, 77.0, 84.0, 36.0),
            thumb=(28.0, -2.0, 46.0, 26.0, 30.0),
        ),
        "pinch": HandPose(
            index=(-6.0, 31.0, 59.0, 33.0),
            middle=(1.0, 26.0, 34.0, 20.0),
            ring=(4.0, 20.0, 28.0, 18.0),
            little=(9.0, 14.0, 24.0, 16.0),
            thumb=(23.0, 15.0, 57.0, 0.0, 1.0),
        ),
    }
)
"""Named poses: "flat", "relaxed", "point" (index extended, the others curled) and "pinch"
(thumb and index nearly touching)."""


@dataclass(frozen=True)
class HandShape:
    """Positions, radii and axes of a hand's joints."""

    joints: Mapping[str, Array]
    """Position of each joint [m], shape [3], by the names in JOINT_NAMES."""
    radii: Mapping[str, float]
    """Distance from each joint to the skin [m], by the same names."""
    axes: Mapping[str, Array]
    """Axes of each joint as columns, shape [3, 3]: Y towards the tip, Z out of the hand's back."""
    palm_scale: Array
    """Breadth, length and thickness of the palm relative to the average hand, shape [3]."""


def hand_shape(
    side: str = "right",
    *,
    length: float = REFERENCE_LENGTH,
    pose: str | HandPose = "flat",
    proportions: HandProportions = AVERAGE,
) -> HandShape:
    """Place the 26 joints of a hand.

    Args:
        side: "right" or "left".
        length: From the wrist joint to the tip of the straight middle finger [m].
        pose: A name in POSES, or joint angles.
        proportions: Sizes of the hand's parts relative to each other.

    Raises:
        ValueError: The side or the pose is unknown, or the length is not positive.
    """
    factor = scale_factors(side, length)
    shape = reference_shape(named_pose(pose), proportions)
    mirror = np.sign(factor)
    return HandShape(
        {name: position * factor for name, position in shape.joints.items()},
        {name: radius * factor[1] for name, radius in shape.radii.items()},
        {name: mirror[:, None] * axes * mirror for name, axes in shape.axes.items()},
        shape.palm_scale,
    )


def scale_factors(side: str, length: float) -> Array:
    """Factors that scale the reference hand to a side and length, shape [3].

    Raises:
        ValueError: The side is unknown, or the length is not positive.
    """
    if side not in ("right", "left"):
        raise ValueError(f'side must be "right" or "left", not {side!r}.')
    if not (np.isfinite(length) and length > 0.0):
        raise ValueError(f"length must be a positive number of meters, not {length!r}.")
    factor = length / REFERENCE_LENGTH
    return np.array([factor if side == "right" else -factor, factor, factor])


def named_pose(pose: str | HandPose) -> HandPose:
    """The pose with a name; a `HandPose` is returned unchanged.

    Raises:
        ValueError: There is no pose with that name.
    """
    if isinstance(pose, HandPose):
        return pose
    if pose not in POSES:
        raise ValueError(f"Unknown pose {pose!r}; the poses are {', '.join(POSES)}.")
    return POSES[pose]


def rotation(axis: int, degrees: float) -> Array:
    """Rotation about a coordinate axis by a right-handed angle, shape [3, 3]."""
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    matrix = np.eye(3)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix[first, first] = matrix[second, second] = cosine
    matrix[second, first], matrix[first, second] = sine, -sine
    return matrix


def frame_along(forward: Array, up: Array) -> Array:
    """Axes as columns: Y is forward, Z as close to up as possible, shape [3, 3]."""
    forward = forward / np.linalg.norm(forward)
    up = up - forward * (up @ forward)
    up = up / np.linalg.norm(up)
    return np.stack([np.cross(forward, up), forward, up], axis=1)


def reference_shape(pose: HandPose, proportions: HandProportions = AVERAGE) -> HandShape:
    """Place the joints of a right hand that is `REFERENCE_LENGTH` long."""
    joints: dict[str, Array] = {"palm": np.array(proportions.palm), "wrist": np.zeros(3)}
    radii: dict[str, float] = {"palm": proportions.palm_radius, "wrist": proportions.wrist_radius}
    frames: dict[str, Array] = {"palm": np.eye(3), "wrist": np.eye(3)}

    flexion, lift, roll, *bends = pose.thumb
    thumb = proportions.thumb
    axes = frame_along(np.array(_THUMB_DIRECTION), np.array(_THUMB_NAIL))
    axes = axes @ rotation(2, -lift) @ rotation(0, -flexion) @ rotation(1, -roll)
    position = np.array(thumb.base)
    tip_inset = (0.0, 0.0, thumb.radii[-1])
    joints["thumb_metacarpal"], radii["thumb_metacarpal"] = position, thumb.radii[0]
    frames["thumb_metacarpal"] = axes
    for index, length in enumerate(thumb.lengths):
        position = position + axes[:, 1] * (length - tip_inset[index])
        joints[f"thumb_{THUMB_SEGMENTS[index + 1]}"] = position
        radii[f"thumb_{THUMB_SEGMENTS[index + 1]}"] = thumb.radii[index + 1]
        if index < 2:
            axes = axes @ rotation(0, -bends[index])
        frames[f"thumb_{THUMB_SEGMENTS[index + 1]}"] = axes

    for name, finger in proportions.fingers.items():
        spread, *bends = getattr(pose, name)
        position = np.array(finger.knuckle)
        joints[f"{name}_metacarpal"], joints[f"{name}_proximal"] = np.array(finger.carpal), position
        frames[f"{name}_metacarpal"] = frame_along(
            position - joints[f"{name}_metacarpal"], np.array([0.0, 0.0, 1.0])
        )
        axes = rotation(2, -spread)
        for index, length in enumerate(finger.lengths):
            axes = axes @ rotation(0, -bends[index])
            frames[f"{name}_{SEGMENTS[index + 1]}"] = axes
            inset = finger.radii[-1] if index == 2 else 0.0
            position = position + axes[:, 1] * (length - inset)
            joints[f"{name}_{SEGMENTS[index + 2]}"] = position
        frames[f"{name}_tip"] = axes
        for segment, radius in zip(SEGMENTS, finger.radii, strict=True):
            radii[f"{name}_{segment}"] = radius
    return HandShape(
        {name: joints[name] for name in JOINT_NAMES},
        {name: radii[name] for name in JOINT_NAMES},
        {name: frames[name] for name in JOINT_NAMES},
        proportions.palm_scale(),
    )
