# SPDX-License-Identifier: GPL-3.0-or-later
"""Joints with orientations from a tracker that gives bare positions, and not all of them.

Trackers of cameras give 20 or 21 points. What is missing (the palm, the bases of the metacarpals,
with some the wrist) is taken from a reference hand laid on the knuckles. A bone's direction gives
two of its three angles; the third, its turn about itself, follows from the bone before it by the
smallest turn, and where a finger is bent, from the plane it bends in.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .....solver.core.errors import TactileClayError
from .....solver.geometry.rotations import (
    cross,
    fitted_rotation,
    quaternions_from_matrices,
    shortest_turn,
)
from ..protocol.joints import FINGERS, JOINT_COUNT, KNUCKLES, PALM, WRIST, reference_hand
from ..protocol.packet import joint_array

Array = NDArray[np.float64]

_ANCHORS = (WRIST, FINGERS[0][0], *KNUCKLES)
"""Joints of the palm that trackers give."""
_FARTHEST, _LARGEST = 90.0, 1.0
"""No joint is further from the tracker than the first, nor from another than the second [m]."""
_SHORTEST = 1e-4
"""A bone shorter than this has no direction [m]."""
_FINGER_BEND, _THUMB_BEND = (0.25, 0.6), (0.6, 1.0)
"""Sine of the bend from which on, and at which wholly, the plane of bending is believed. A thumb
bends less and less evenly, and models of it differ in how its hinges lie."""
_THUMB_COUPLING, _FULL_OPPOSITION = 1.8, np.radians(60.0)
"""A thumb that swings across the palm turns about itself: the joint at its base is a saddle."""


class SkeletonError(TactileClayError, ValueError):
    """Positions make no hand; the message says why."""


def complete_hand(
    positions: ArrayLike,
    side: str,
    *,
    palm_rotation: ArrayLike | None = None,
    radii: ArrayLike | None = None,
) -> NDArray[np.float32]:
    """All 26 joints of a hand, with orientations and radii.

    Args:
        positions: Position of each joint [m], NaN where it is not known, shape [26, 3]. The four
            knuckles, the fingers and the thumb must be known.
        side: Left or right.
        palm_rotation: Axes of the palm as columns, where the tracker gives them, shape [3, 3].
        radii: Distance from each joint to the skin [m], NaN where it is not known, shape [26].

    Returns:
        As in a datagram, shape [26, 8].

    Raises:
        SkeletonError: Joints that must be known are not, or lie on one spot.
    """
    points = np.array(positions, np.float64)
    reference = reference_hand(side)
    known = np.isfinite(points).all(axis=1)
    needed = [joint for finger in FINGERS for joint in finger[1:]] + [FINGERS[0][0]]
    if not known[needed].all():
        raise SkeletonError("joints of the fingers are missing")
    if np.abs(points[known]).max() > _FARTHEST:
        raise SkeletonError("a joint is too far away")
    if np.ptp(points[known], axis=0).max() > _LARGEST:
        raise SkeletonError("joints are too far from each other")
    anchors = [joint for joint in _ANCHORS if known[joint]]
    lay = reference.positions[anchors]
    if palm_rotation is None:
        rotation = fitted_rotation(lay, points[anchors])
    else:
        rotation = np.asarray(palm_rotation, np.float64)
    size = float(np.sqrt(points[anchors].var(axis=0).sum() / lay.var(axis=0).sum()))
    if not 0.2 < size < 5.0:
        raise SkeletonError("the palm has no size of a hand")
    origin = points[anchors].mean(axis=0) - size * rotation @ lay.mean(axis=0)
    points[~known] = origin + size * reference.positions[~known] @ rotation.T
    rotations = _rotations(points, rotation, side)
    thickness = size * reference.radii
    if radii is not None:
        given = np.asarray(radii, np.float64)
        thickness = np.where(np.isfinite(given) & (given > 0.0), given, thickness)
    return joint_array(points, quaternions_from_matrices(rotations), np.clip(thickness, 0.0, 0.1))


def _rotations(points: Array, palm: Array, side: str) -> Array:
    """Orientation of each joint, shape [26, 3, 3]."""
    reference = reference_hand(side).rotations
    rotations = np.empty((JOINT_COUNT, 3, 3))
    rotations[WRIST] = rotations[PALM] = palm
    for finger in FINGERS:
        bones = np.diff(points[list(finger)], axis=0)
        lengths = np.linalg.norm(bones, axis=1)
        if lengths.min() < _SHORTEST:
            raise SkeletonError("two joints of a finger lie on one spot")
        directions = bones / lengths[:, None]
        # How a finger's first bone lies in the palm tells its turn: the thumb's nail looks aside.
        thumb = len(finger) == 4
        before = palm @ reference[finger[0]]
        if thumb:
            before = before @ _opposition(before, directions[0], mirrored=side == "left")
        # Its last two joints are hinges, so that its last three bones bend in one plane.
        bend = cross(directions[-3], directions[-2]) + cross(directions[-2], directions[-1])
        for joint, direction in zip(finger[:-1], directions, strict=True):
            before = shortest_turn(-before[:, 2], direction) @ before
            if joint in finger[-4:]:
                before = _turned_into_plane(before, bend, _THUMB_BEND if thumb else _FINGER_BEND)
            rotations[joint] = before
        rotations[finger[-1]] = before
    return rotations


def _opposition(rest: Array, direction: Array, *, mirrored: bool) -> Array:
    """How far a thumb has turned about itself by swinging across the palm, shape [3, 3]."""
    _, down, back = rest.T @ direction
    flexion = float(np.arctan2(-down, -back))
    roll = float(np.clip(_THUMB_COUPLING * flexion, 0.0, _FULL_OPPOSITION))
    cosine, sine = np.cos(roll), np.sin(-roll if mirrored else roll)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _turned_into_plane(rotation: Array, normal: Array, bends: tuple[float, float]) -> Array:
    """Turn a bone about itself so that its finger bends about its X axis, as far as it is bent."""
    forward = -rotation[:, 2]
    normal = normal - forward * (forward @ normal)
    bend = float(np.linalg.norm(normal))
    first, full = bends
    if bend < first:
        return rotation
    # Towards the palm is a turn about -X; a finger bent backwards shows the same plane.
    axis = -normal / bend
    across = rotation[:, 0]
    cosine = float(axis @ across)
    if cosine < 0.0:
        axis, cosine = -axis, -cosine
    if cosine < 0.5:
        # More than sixty degrees off: noise, or no finger.
        return rotation
    share = min(1.0, (bend - first) / (full - first))
    right = across + share * (axis - across)
    right -= forward * (forward @ right)
    right /= np.linalg.norm(right)
    back = -forward
    return np.stack([right, cross(back, right), back], axis=1)
