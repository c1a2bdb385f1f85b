# SPDX-License-Identifier: GPL-3.0-or-later
"""The size of the person's own hand, from the first frames of it."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from .....solver.geometry.rotations import matrices_from_quaternions
from .. import TrackingError
from ..protocol.joints import (
    ALL_JOINTS,
    FINGERS,
    JOINT_COUNT,
    KNUCKLES,
    PALM,
    WRIST,
    reference_hand,
)
from ..protocol.packet import HandFrame
from .presence import TRUST

Array = NDArray[np.float64]

FEWEST_FRAMES = 10
_MOST_FRAMES = 600
_LEAST_SHARE, _LARGEST_SHARE = 0.4, 2.5
"""A bone is taken to be no shorter and no longer than so many times the reference hand's."""


def measured_hand(frames: Iterable[HandFrame]) -> tuple[Array, Array]:
    """Joints and radii of a flat hand with the measures of the person's own.

    Takes the median length of each bone and the median places of the palm's joints, so that frames
    in which the tracker was wrong do not matter. Trackers put the tip joint on the skin; here it is
    a radius inside, so that a hand rounded about it ends where the finger does.

    Args:
        frames: Frames of one hand; at most the first 600 that can be trusted are looked at.

    Returns:
        Position of each joint [m], shape [26, 3], and its distance to the skin [m], shape [26]: a
        flat hand with the wrist at the origin, fingers to -Z and the back to +Y, as in `joints`.

    Raises:
        TrackingError: Less than ten frames can be trusted.
    """
    side = ""
    places, thicknesses = [], []
    for frame in frames:
        if not frame.usable or frame.valid != ALL_JOINTS or frame.confidence < TRUST:
            continue
        side = side or frame.side
        if frame.side != side:
            continue
        rotation = matrices_from_quaternions(frame.quaternions[WRIST])
        positions = frame.positions.astype(np.float64)
        places.append((positions - positions[WRIST]) @ rotation)
        thicknesses.append(frame.radii.astype(np.float64))
        if len(places) == _MOST_FRAMES:
            break
    if len(places) < FEWEST_FRAMES:
        raise TrackingError(
            f"The hand was seen well in {len(places)} frames only; {FEWEST_FRAMES} are needed to "
            "measure it. Hold it flat in view for a second."
        )
    seen, radii = np.array(places), np.median(np.array(thicknesses), axis=0)
    reference = reference_hand(side)
    positions = np.zeros((JOINT_COUNT, 3))
    size = _ratio(seen, reference.positions, WRIST, KNUCKLES[1])
    # A tracker that gives no radii gives zeros.
    radii = np.where(radii > 1e-4, radii, size * reference.radii)
    # Each tracker has its own idea of the palm's middle.
    positions[PALM] = size * reference.positions[PALM]
    for finger in FINGERS:
        # The palm's joints keep their places, the fingers are laid out straight.
        fixed = finger[:2] if len(finger) == 5 else finger[:1]
        for joint in fixed:
            positions[joint] = np.median(seen[:, joint], axis=0)
        for joint, following in pairwise(finger):
            if following in fixed:
                continue
            bone = reference.positions[following] - reference.positions[joint]
            ratio = _ratio(seen, reference.positions, joint, following)
            if following == finger[-1]:
                length = ratio * float(np.linalg.norm(bone))
                inset = min(float(radii[following]), 0.5 * length)
                ratio *= (length - inset) / length
            positions[following] = positions[joint] + ratio * bone
    return positions, radii


def _ratio(seen: Array, reference: Array, joint: int, following: int) -> float:
    """How much longer a bone is than the reference hand's."""
    lengths = np.linalg.norm(seen[:, following] - seen[:, joint], axis=1)
    usual = float(np.linalg.norm(reference[following] - reference[joint]))
    return float(np.clip(np.median(lengths) / usual, _LEAST_SHARE, _LARGEST_SHARE))
