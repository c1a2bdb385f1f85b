# SPDX-License-Identifier: GPL-3.0-or-later
"""Completes hands from trackers that give only positions, and not of all joints.

Camera-based trackers give 20 or 21 points. Missing joints (the palm, the bases of the metacarpals
and sometimes the wrist) are taken from a reference hand fitted to the knuckles. A bone's direction
gives two of its three angles. The third, its roll, follows from the previous bone by the smallest
rotation and, if the finger is bent, from the plane in which it bends.
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
_MAX_DISTANCE, _MAX_EXTENT = 90.0, 1.0
"""Largest distance of a joint from the tracker, and extent of a hand along any axis [m]."""
_MIN_BONE_LENGTH = 1e-4
"""A bone shorter than this has no direction [m]."""
_FINGER_BEND, _THUMB_BEND = (0.25, 0.6), (0.6, 1.0)
"""Bends above which the plane of bending is used, and above which it is used fully: sums of the
sines at the last two joints. A thumb bends less and less regularly, and trackers disagree about its
hinge axes."""
_THUMB_COUPLING, _MAX_OPPOSITION = 1.8, np.radians(60.0)
"""Roll of the thumb per flexion across the palm, and its maximum: the base is a saddle joint."""


class SkeletonError(TactileClayError, ValueError):
    """Joint positions do not form a hand; the message says why."""


def complete_hand(
    positions: ArrayLike,
    side: str,
    *,
    palm_rotation: ArrayLike | None = None,
    radii: ArrayLike | None = None,
) -> NDArray[np.float32]:
    """Compute all 26 joints of a hand, with orientations and radii.

    Args:
        positions: Position of each joint [m], NaN if unknown, shape [26, 3]. The four knuckles,
            the fingers and the thumb must be known.
        side: Left or right.
        palm_rotation: Axes of the palm as columns, shape [3, 3], if the tracker gives them.
        radii: Distance from each joint to the skin [m], NaN if unknown, shape [26].

    Returns:
        The joints in the datagram's layout, shape [26, 8].

    Raises:
        SkeletonError: A required joint is missing, two coincide, or they are implausibly far apart.
    """
    points = np.array(positions, np.float64)
    reference = reference_hand(side)
    known = np.isfinite(points).all(axis=1)
    required = [joint for finger in FINGERS for joint in finger[1:]] + [FINGERS[0][0]]
    if not known[required].all():
        raise SkeletonError("finger joints are missing")
    if np.abs(points[known]).max() > _MAX_DISTANCE:
        raise SkeletonError("a joint is too far away")
    if np.ptp(points[known], axis=0).max() > _MAX_EXTENT:
        raise SkeletonError("joints are too far from each other")
    anchors = [joint for joint in _ANCHORS if known[joint]]
    model = reference.positions[anchors]
    if palm_rotation is None:
        rotation = fitted_rotation(model, points[anchors])
    else:
        rotation = np.asarray(palm_rotation, np.float64)
    size = float(np.sqrt(points[anchors].var(axis=0).sum() / model.var(axis=0).sum()))
    if not 0.2 < size < 5.0:
        raise SkeletonError("the size of the palm is implausible")
    origin = points[anchors].mean(axis=0) - size * rotation @ model.mean(axis=0)
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
        if lengths.min() < _MIN_BONE_LENGTH:
            raise SkeletonError("two joints of a finger are at the same position")
        directions = bones / lengths[:, None]
        # The first bone has the roll it has in the reference hand: a thumbnail faces sideways.
        thumb = len(finger) == 4
        axes = palm @ reference[finger[0]]
        if thumb:
            axes = axes @ _opposition(axes, directions[0], mirrored=side == "left")
        # The last two joints are hinges, so the last three bones bend in one plane.
        bend = cross(directions[-3], directions[-2]) + cross(directions[-2], directions[-1])
        for joint, direction in zip(finger[:-1], directions, strict=True):
            axes = shortest_turn(-axes[:, 2], direction) @ axes
            if joint in finger[-4:]:
                axes = _aligned_with_plane(axes, bend, _THUMB_BEND if thumb else _FINGER_BEND)
            rotations[joint] = axes
        rotations[finger[-1]] = axes
    return rotations


def _opposition(rest: Array, direction: Array, *, mirrored: bool) -> Array:
    """Roll of the thumb due to its flexion across the palm, shape [3, 3]."""
    _, down, back = rest.T @ direction
    flexion = float(np.arctan2(-down, -back))
    roll = float(np.clip(_THUMB_COUPLING * flexion, 0.0, _MAX_OPPOSITION))
    cosine, sine = np.cos(roll), np.sin(-roll if mirrored else roll)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _aligned_with_plane(rotation: Array, normal: Array, bends: tuple[float, float]) -> Array:
    """Roll a bone so that its X axis is normal to the plane in which the finger bends.

    Args:
        rotation: Axes of the bone as columns, shape [3, 3].
        normal: Normal of the plane, shape [3]; its length measures the bend.
        bends: Bends at which the roll begins and is complete.
    """
    forward = -rotation[:, 2]
    normal = normal - forward * (forward @ normal)
    bend = float(np.linalg.norm(normal))
    first, full = bends
    if bend < first:
        return rotation
    # Bending towards the palm rotates about -X; a finger bent backwards has the same plane.
    axis = -normal / bend
    across = rotation[:, 0]
    cosine = float(axis @ across)
    if cosine < 0.0:
        axis, cosine = -axis, -cosine
    if cosine < 0.5:
        # More than sixty degrees off: noise, or not a finger.
        return rotation
    share = min(1.0, (bend - first) / (full - first))
    right = across + share * (axis - across)
    right -= forward * (forward @ right)
    right /= np.linalg.norm(right)
    back = -forward
    return np.stack([right, cross(back, right), back], axis=1)
