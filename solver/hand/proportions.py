# SPDX-License-Identifier: GPL-3.0-or-later
"""How large the parts of a hand are: those of an average adult, or those a tracker measured.

The joints are those of OpenXR's XR_EXT_hand_tracking. Lengths of the average hand's bones follow
Buryanov and Kotiuk, "Proportions of Hand Segments", International Journal of Morphology 28(3),
2010; breadths are rounded averages of adult hands.

Frame: the wrist joint is the origin, straight fingers point to +Y, the back of the hand to +Z, and
the thumb of a right hand to -X.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

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
"""Length that proportions are given for [m]."""

_LEAST, _MOST = 0.4, 2.5
"""What a measured length or radius may be, over the average hand's."""


class Finger(NamedTuple):
    """One finger [m]."""

    carpal: Vec3
    """Base of the metacarpal."""
    knuckle: Vec3
    """Head of the metacarpal, where the finger bends."""
    lengths: Vec3
    """Proximal and intermediate bone, then the distal bone with the pad before it."""
    radii: tuple[float, float, float, float, float]
    """At the metacarpal's base, the knuckle, the two finger joints and the tip."""


class Thumb(NamedTuple):
    """The thumb [m]."""

    base: Vec3
    """Base of the metacarpal."""
    lengths: Vec3
    """Metacarpal and proximal bone, then the distal bone with the pad before it."""
    radii: tuple[float, float, float, float]
    """At the metacarpal's base, the two joints and the tip."""


@dataclass(frozen=True)
class HandProportions:
    """Lengths and radii of a right hand, scaled so that it is `REFERENCE_LENGTH` long.

    A hand's length is measured from the wrist joint to the tip of the straight middle finger.
    """

    palm: Vec3
    """Palm joint [m]."""
    palm_radius: float
    """[m]"""
    wrist_radius: float
    """[m]"""
    thumb: Thumb
    """The thumb."""
    fingers: Mapping[str, Finger]
    """The other fingers, by their names in FINGERS."""

    def palm_scale(self) -> Array:
        """Breadth, length and thickness of the palm over the average hand's, shape [3]."""
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


def measured_proportions(
    joints: ArrayLike, radii: ArrayLike, side: str
) -> tuple[float, HandProportions]:
    """Take a person's own sizes from one tracked frame of their hand, in whatever pose.

    The palm's joints keep their places in the palm; fingers keep the lengths of their bones.

    Args:
        joints: Positions of the joints in the order of JOINT_NAMES [m], shape [26, 3], in any
            right-handed frame.
        radii: Distance of the skin from each [m], shape [26].
        side: "right" or "left".

    Returns:
        The hand's length [m] and its proportions.

    Raises:
        ValueError: Values are missing, not finite, or not those of a hand; the message names the
            bone.
    """
    place, radius = np.array(joints, np.float64), np.array(radii, np.float64)
    if side not in ("right", "left"):
        raise ValueError(f'side must be "right" or "left", not {side!r}.')
    if place.shape != (26, 3) or radius.shape != (26,):
        raise ValueError(
            f"A hand has 26 joints of three coordinates and 26 radii, not {place.shape} and "
            f"{radius.shape}."
        )
    bad = [
        name
        for name, where, size in zip(JOINT_NAMES, place, radius, strict=True)
        if not (np.isfinite(where).all() and np.isfinite(size) and size > 0.0)
    ]
    if bad:
        raise ValueError(
            f"The tracker gave no position or no radius above zero for {', '.join(bad)}. Measure "
            "again with the whole hand in view."
        )
    if np.ptp(place, axis=0).max() < 0.01:
        raise ValueError("The tracker has all joints in one place. Measure again.")
    if side == "left":
        place[:, 0] *= -1.0
    place = _in_palm_frame(dict(zip(JOINT_NAMES, place, strict=True)))
    measured = dict(zip(JOINT_NAMES, zip(place, radius, strict=True), strict=True))
    middle = _finger(measured, "middle")
    length = middle.knuckle[1] + sum(middle.lengths)
    factor = REFERENCE_LENGTH / length
    scaled = {name: (where * factor, size * factor) for name, (where, size) in measured.items()}
    hand = HandProportions(
        palm=_vec3(scaled["palm"][0]),
        palm_radius=float(scaled["palm"][1]),
        wrist_radius=float(scaled["wrist"][1]),
        thumb=_thumb(scaled),
        fingers=MappingProxyType({name: _finger(scaled, name) for name in FINGERS}),
    )
    _check(hand, factor)
    return float(length), hand


_Measured = Mapping[str, tuple[Array, float]]


def _in_palm_frame(joints: Mapping[str, Array]) -> Array:
    """Turn and move joints so that the palm lies as the average hand's does, shape [26, 3]."""
    points, targets = [joints["wrist"]], [np.zeros(3)]
    for name in FINGERS:
        points += [joints[f"{name}_metacarpal"], joints[f"{name}_proximal"]]
        targets += [np.array(AVERAGE.fingers[name].carpal), np.array(AVERAGE.fingers[name].knuckle)]
    own, target = np.array(points), np.array(targets)
    left, _, right = np.linalg.svd((own - own[0]).T @ target)
    # Kabsch's method, without mirroring: a flat palm would else be turned over.
    left[:, 2] *= np.sign(np.linalg.det(left @ right))
    return (np.array([joints[name] for name in JOINT_NAMES]) - own[0]) @ (left @ right)


def _finger(measured: _Measured, name: str) -> Finger:
    chain = [measured[f"{name}_{segment}"] for segment in SEGMENTS]
    way = [float(np.linalg.norm(b[0] - a[0])) for a, b in pairwise(chain[1:])]
    radii = tuple(float(size) for _, size in chain)
    assert len(radii) == 5
    return Finger(
        _vec3(chain[0][0]), _vec3(chain[1][0]), (way[0], way[1], way[2] + radii[-1]), radii
    )


def _thumb(measured: _Measured) -> Thumb:
    chain = [measured[f"thumb_{segment}"] for segment in THUMB_SEGMENTS]
    way = [float(np.linalg.norm(b[0] - a[0])) for a, b in pairwise(chain)]
    radii = tuple(float(size) for _, size in chain)
    assert len(radii) == 4
    return Thumb(_vec3(chain[0][0]), (way[0], way[1], way[2] + radii[-1]), radii)


def _vec3(point: Array) -> Vec3:
    return float(point[0]), float(point[1]), float(point[2])


def _palm_size(hand: HandProportions) -> Vec3:
    """Breadth over the knuckles, length up to them, and mean thickness [m]."""
    knuckles = np.array([finger.knuckle for finger in hand.fingers.values()])
    girth = [radius for finger in hand.fingers.values() for radius in finger.radii[:2]]
    return (
        float(np.linalg.norm(knuckles[-1] - knuckles[0])),
        float(np.linalg.norm(knuckles, axis=1).mean()),
        float(np.mean([hand.wrist_radius, *girth])),
    )


def _sizes(hand: HandProportions) -> dict[str, float]:
    """Every length and radius, by the joint that it belongs to."""
    sizes = {"radius of wrist": hand.wrist_radius, "radius of palm": hand.palm_radius}
    parts: dict[str, tuple[tuple[str, ...], Finger | Thumb]] = {
        "thumb": (THUMB_SEGMENTS, hand.thumb)
    }
    for name, finger in hand.fingers.items():
        parts[name] = (SEGMENTS, finger)
        bone = np.subtract(finger.knuckle, finger.carpal)
        sizes[f"length of {name}_metacarpal"] = float(np.linalg.norm(bone))
        sizes[f"length from wrist to {name}_proximal"] = float(np.linalg.norm(finger.knuckle))
    for name, (segments, part) in parts.items():
        for segment, length in zip(segments[-4:-1], part.lengths, strict=True):
            sizes[f"length of {name}_{segment}"] = length
        for segment, radius in zip(segments, part.radii, strict=True):
            sizes[f"radius of {name}_{segment}"] = radius
    return sizes


def _check(hand: HandProportions, factor: float) -> None:
    average = _sizes(AVERAGE)
    for name, size in _sizes(hand).items():
        if not _LEAST < size / average[name] < _MOST:
            raise ValueError(
                f"The {name} is {1e3 * size / factor:.1f} mm; for a hand of this length it would "
                f"be about {1e3 * average[name] / factor:.1f} mm. Measure again with the whole "
                "hand in view."
            )
