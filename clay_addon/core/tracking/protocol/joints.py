# SPDX-License-Identifier: GPL-3.0-or-later
"""The 26 joints of OpenXR's XR_EXT_hand_tracking, in its order, and a reference hand.

Axes are OpenXR's: a joint's -Z points along its bone towards the fingertip, its Y out of the back
of the hand (or the nail), its X to the right. Tracking space is right-handed, with Y up.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .....solver.hand.proportions import JOINT_NAMES
from .....solver.hand.shape import hand_shape

__all__ = [
    "ALL_JOINTS",
    "FINGERS",
    "FROM_ROOT",
    "JOINT_COUNT",
    "JOINT_NAMES",
    "KNUCKLES",
    "PALM",
    "PALM_JOINTS",
    "PARENTS",
    "SIDES",
    "WRIST",
    "ReferenceHand",
    "reference_hand",
]

JOINT_COUNT = 26
PALM = 0
WRIST = 1
SIDES = ("left", "right")
"""The sides; the index of each is its code in a datagram."""

FINGERS: tuple[tuple[int, ...], ...] = (
    (2, 3, 4, 5),
    (6, 7, 8, 9, 10),
    (11, 12, 13, 14, 15),
    (16, 17, 18, 19, 20),
    (21, 22, 23, 24, 25),
)
"""Joints of each finger from the metacarpal to the tip, starting with the thumb."""

KNUCKLES = (7, 12, 17, 22)
"""Proximal joints of the four fingers."""

PALM_JOINTS = (WRIST, *KNUCKLES)
"""Joints whose mutual distances hardly change when fingers move."""

ALL_JOINTS = (1 << JOINT_COUNT) - 1
"""Mask with a bit for each joint."""


def _parents() -> tuple[int, ...]:
    parents = [WRIST] * JOINT_COUNT
    parents[WRIST] = -1
    for finger in FINGERS:
        for joint, following in pairwise(finger):
            parents[following] = joint
    return tuple(parents)


PARENTS = _parents()
"""The parent of each joint; -1 for the wrist."""

FROM_ROOT = (WRIST, PALM, *(joint for finger in FINGERS for joint in finger))
"""All joints, parents before children."""


class ReferenceHand(NamedTuple):
    """A flat hand with its wrist at the origin; fingers point to -Z, the back of the hand to +Y."""

    positions: NDArray[np.float64]
    """Position of each joint [m], shape [26, 3]."""
    rotations: NDArray[np.float64]
    """Axes of each joint as columns, shape [26, 3, 3]."""
    radii: NDArray[np.float64]
    """Distance from each joint to the skin [m], shape [26]."""


@cache
def reference_hand(side: str) -> ReferenceHand:
    """The joints of the default hand, in OpenXR's axes.

    Raises:
        ValueError: The side is neither left nor right.
    """
    shape = hand_shape(side)
    # The default hand's fingers point to +Y, its back to +Z.
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    positions = np.array([turn @ shape.joints[name] for name in JOINT_NAMES])
    rotations = np.array([turn @ shape.axes[name] @ turn.T for name in JOINT_NAMES])
    radii = np.array([shape.radii[name] for name in JOINT_NAMES])
    for array in (positions, rotations, radii):
        array.flags.writeable = False
    return ReferenceHand(positions, rotations, radii)
