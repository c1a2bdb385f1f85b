# SPDX-License-Identifier: GPL-3.0-or-later
"""Proportions of hands, and those of an average adult.

The joints are those of OpenXR's XR_EXT_hand_tracking. The average bone lengths follow Buryanov and
Kotiuk, "Proportions of Hand Segments", International Journal of Morphology 28(3), 2010; breadths
are rounded averages of adult hands.

Frame: the wrist joint is the origin, straight fingers point to +Y, the back of the hand to +Z, and
the thumb of a right hand to -X.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Vec3 = tuple[float, float, float]

FINGERS = ("index", "middle", "ring", "little")
SEGMENTS = ("metacarpal", "proximal", "intermediate", "distal", "tip")
THUMB_SEGMENTS = ("metacarpal", "proximal", "distal", "tip")

JOINT_NAMES: tuple[str, ...] = (
    "palm",
    "wrist",
    *(f"thumb_{segment}" for segment in THUMB_SEGMENTS),
    *(f"{finger}_{segment}" for finger in FINGERS for segment in SEGMENTS),
)
"""The joints of XrHandJointEXT, in its order."""

REFERENCE_LENGTH = 0.19
"""Hand length to which proportions refer [m]."""


class Finger(NamedTuple):
    """One finger [m]."""

    carpal: Vec3
    """Base of the metacarpal."""
    knuckle: Vec3
    """Head of the metacarpal, where the finger bends."""
    lengths: Vec3
    """Proximal and intermediate bone, then the distal bone including the pad beyond it."""
    radii: tuple[float, float, float, float, float]
    """At the metacarpal's base, the knuckle, the two finger joints and the tip."""


class Thumb(NamedTuple):
    """The thumb [m]."""

    base: Vec3
    """Base of the metacarpal."""
    lengths: Vec3
    """Metacarpal and proximal bone, then the distal bone including the pad beyond it."""
    radii: tuple[float, float, float, float]
    """At the metacarpal's base, the two joints and the tip."""


@dataclass(frozen=True)
class HandProportions:
    """Lengths and radii of a right hand, scaled to a length of `REFERENCE_LENGTH`.

    A hand's length is measured from the wrist joint to the tip of the straight middle finger.
    """

    palm: Vec3
    """Position of the palm joint [m]."""
    palm_radius: float
    """Radius at the palm joint [m]."""
    wrist_radius: float
    """Radius at the wrist joint [m]."""
    thumb: Thumb
    """The thumb."""
    fingers: Mapping[str, Finger]
    """The other fingers, by their names in FINGERS."""

    def palm_scale(self) -> Array:
        """Breadth, length and thickness of the palm relative to the average hand, shape [3]."""
        sizes = np.array([_palm_size(hand) for hand in (self, AVERAGE)])
        return sizes[0] / sizes[1]


AVERAGE = HandProportions(
    palm=(-0.003, 0.064, 0.0),
    palm_radius=0.0140,
    wrist_radius=0.0185,
    thumb=Thumb(
        (-0.0190, 0.0200, -0.0100), (0.0462, 0.0316, 0.0273), (0.0150, 0.0125, 0.0110, 0.0086)
    ),
    fingers=MappingProxyType(
        {
            "index": Finger(
                (-0.0140, 0.0290, 0.0010),
                (-0.0275, 0.0955, 0.0030),
                (0.0398, 0.0224, 0.0197),
                (0.0120, 0.0112, 0.0091, 0.0081, 0.0070),
            ),
            "middle": Finger(
                (-0.0040, 0.0330, 0.0030),
                (-0.0070, 0.0976, 0.0055),
                (0.0446, 0.0263, 0.0214),
                (0.0125, 0.0115, 0.0094, 0.0083, 0.0072),
            ),
            "ring": Finger(
                (0.0065, 0.0330, 0.0015),
                (0.0125, 0.0910, 0.0035),
                (0.0414, 0.0257, 0.0213),
                (0.0122, 0.0109, 0.0088, 0.0078, 0.0068),
            ),
            "little": Finger(
                (0.0165, 0.0300, -0.0020),
                (0.0295, 0.0820, -0.0015),
                (0.0327, 0.0181, 0.0197),
                (0.0115, 0.0100, 0.0079, 0.0070, 0.0061),
            ),
        }
    ),
)
"""An average adult hand."""


def _palm_size(hand: HandProportions) -> Vec3:
    """Breadth over the knuckles, length up to them, and mean thickness [m]."""
    knuckles = np.array([finger.knuckle for finger in hand.fingers.values()])
    girth = [radius for finger in hand.fingers.values() for radius in finger.radii[:2]]
    return (
        float(np.linalg.norm(knuckles[-1] - knuckles[0])),
        float(np.linalg.norm(knuckles, axis=1).mean()),
        float(np.mean([hand.wrist_radius, *girth])),
    )
