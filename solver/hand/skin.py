# SPDX-License-Identifier: GPL-3.0-or-later
"""The skin of a hand as a signed distance: a smooth union of round cones and ellipsoids.

Fingers join the palm smoothly, but each other sharply, so that they never merge. All lengths are
for a hand of `REFERENCE_LENGTH`.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .proportions import FINGERS
from .shape import HandShape, frame_along

Array = NDArray[np.float64]


def round_cone(points: Array, start: Array, end: Array, first: float, second: float) -> Array:
    """Signed distance to the convex hull of two balls [m], shape [N].

    Args:
        points: Points [m], shape [N, 3].
        start: Center of the first ball [m], shape [3].
        end: Center of the second ball [m], shape [3].
        first: Radius of the first ball [m].
        second: Radius of the second ball [m].
    """
    axis = end - start
    length = float(np.linalg.norm(axis))
    slope = float(np.clip((first - second) / length, -0.999, 0.999))
    rise = float(np.sqrt(1.0 - slope * slope))
    offset = points - start
    along = offset @ (axis / length)
    across = np.sqrt(np.maximum((offset * offset).sum(axis=1) - along * along, 0.0))
    seat = along - across * (slope / rise)
    side = across * rise + along * slope - first
    at_start = np.hypot(along, across) - first
    at_end = np.hypot(along - length, across) - second
    return np.where(seat < 0.0, at_start, np.where(seat > length, at_end, side))


def ellipsoid(points: Array, center: Array, axes: Array, radii: ArrayLike) -> Array:
    """Approximate signed distance to an ellipsoid, accurate near its surface [m], shape [N]."""
    local = (points - center) @ axes
    scaled = np.linalg.norm(local / np.asarray(radii), axis=1)
    slope = np.maximum(np.linalg.norm(local / np.square(radii), axis=1), 1e-9)
    return scaled * (scaled - 1.0) / slope


def blend(first: Array, second: Array, width: float | Array) -> Array:
    """Union of two distances with a fillet of the given width [m], shape [N]."""
    overlap = np.maximum(width - np.abs(first - second), 0.0)
    return np.minimum(first, second) - overlap * overlap * (0.25 / width)


def skin_distance(points: Array, shape: HandShape) -> Array:
    """Signed distance to the skin of the reference hand [m], shape [N]."""
    palm = _palm_distance(points, shape)
    distance = palm
    for name in ("thumb", *FINGERS):
        finger = _finger_distance(points, shape, name)
        # Only the root of a finger blends with the palm; a fingertip that touches it does not.
        knuckle = f"{name}_proximal"
        radii = np.linalg.norm(points - shape.joints[knuckle], axis=1) / shape.radii[knuckle]
        distance = np.minimum(distance, blend(palm, finger, 0.005 * np.clip(3 - radii, 0.05, 1)))
    return distance


def _palm_distance(points: Array, shape: HandShape) -> Array:
    """Signed distance to palm, web, ball of the thumb and wrist [m], shape [N]."""
    joints, radii, axes, scale = shape.joints, shape.radii, shape.axes, shape.palm_scale
    thick = float(scale[2])
    distance = round_cone(
        points,
        scale * (-0.0095, 0.034, -0.001),
        scale * (-0.0090, -0.06, 0.0),
        0.0165 * thick,
        0.0185 * thick,
    )
    ulnar = round_cone(
        points,
        scale * (0.0125, 0.030, -0.003),
        scale * (0.0100, -0.06, 0.0),
        0.0150 * thick,
        0.0180 * thick,
    )
    distance = blend(distance, ulnar, 0.012)
    for name in FINGERS:
        base, knuckle = f"{name}_metacarpal", f"{name}_proximal"
        bone = round_cone(points, joints[base], joints[knuckle], radii[base], radii[knuckle])
        distance = blend(distance, bone, 0.010)
        forward = joints[f"{name}_intermediate"] - joints[knuckle]
        web = joints[knuckle] + 0.22 * forward - 0.002 * axes[knuckle][:, 2]
        root = round_cone(points, joints[knuckle], web, radii[knuckle], 0.92 * radii[knuckle])
        distance = blend(distance, root, 0.008)

    start, end = joints["thumb_metacarpal"], joints["thumb_proximal"]
    bone = round_cone(points, start, end, radii["thumb_metacarpal"], radii["thumb_proximal"])
    distance = blend(distance, bone, 0.012)
    ball = 0.58 * start + 0.42 * end + scale * (0.010, 0.002, -0.004)
    along = frame_along(end - start, np.array([0.0, 0.0, 1.0]))
    thenar = ellipsoid(points, ball, along, scale * (0.0155, 0.0245, 0.0150))
    distance = blend(distance, thenar, 0.012)
    index = joints["index_metacarpal"] * 0.45 + joints["index_proximal"] * 0.55
    fold = round_cone(points, 0.35 * start + 0.65 * end, index, 0.0085 * thick, 0.0090 * thick)
    distance = blend(distance, fold, 0.016)
    hypothenar = ellipsoid(
        points,
        scale * (0.0245, 0.045, -0.0095),
        np.eye(3),
        scale * (0.0135, 0.0330, 0.0125),
    )
    distance = blend(distance, hypothenar, 0.012)
    cut = -0.034 * scale[1] - points[:, 1]
    return -blend(-distance, -cut, 0.006)


def _finger_distance(points: Array, shape: HandShape, name: str) -> Array:
    """Signed distance to one finger beyond its knuckle [m], shape [N]."""
    joints, radii, axes = shape.joints, shape.radii, shape.axes
    chain = [joint for joint in joints if joint.startswith(name)][1:]
    distance = np.full(len(points), 1.0)
    for start, end in pairwise(chain):
        bone = round_cone(points, joints[start], joints[end], radii[start], radii[end])
        distance = blend(distance, bone, 0.002)
        middle = 0.45 * joints[start] + 0.55 * joints[end]
        girth = 0.5 * (radii[start] + radii[end])
        pad = ellipsoid(
            points,
            middle - 0.17 * girth * axes[start][:, 2],
            axes[start],
            (0.86 * girth, 0.46 * float(np.linalg.norm(joints[end] - joints[start])), 0.90 * girth),
        )
        distance = blend(distance, pad, 0.004)
    return distance
