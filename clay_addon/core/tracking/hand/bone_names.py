# SPDX-License-Identifier: GPL-3.0-or-later
"""Identifies joints and side of a hand by bone names as in OpenXR, WebXR, Rigify and Mixamo."""

from __future__ import annotations

import re
from collections.abc import Iterable

from .....solver.hand.bone_names import FINGER_WORDS
from .....solver.hand.proportions import SEGMENTS, THUMB_SEGMENTS
from ..protocol.joints import FINGERS, PALM, SIDES, WRIST

_SEGMENT_WORDS = {
    **{segment: segment for segment in SEGMENTS},
    "carpal": "metacarpal",
    "palm": "metacarpal",
    "knuckle": "proximal",
    "middlephalanx": "intermediate",
    "end": "tip",
}
_FILLER_WORDS = frozenset(
    [
        "xr",
        "ext",
        "hand",
        "joint",
        "finger",
        "phalanx",
        "f",
        "l",
        "r",
        "left",
        "right",
        "b",
        "bone",
        "def",
        "org",
        "mixamorig",
    ]
)


def joints_of_bones(names: Iterable[str]) -> dict[str, int]:
    """Find the joint that each bone represents.

    Args:
        names: Bone names in the rig's order. If several match a joint, the first is used.

    Returns:
        Joint index of each bone that is a joint of a hand.
    """
    joints: dict[str, int] = {}
    for name in names:
        joint = _joint(name)
        if joint is not None and joint not in joints.values():
            joints[name] = joint
    return joints


def side_of_rig(rig_name: str, bone_names: Iterable[str]) -> str:
    """The side that a rig's name, or else most of its bones' names, contain.

    Args:
        rig_name: Name of the rig, such as ``Hand.L``, ``l_hand`` or ``lefthand``.
        bone_names: Names of its bones, such as ``LeftHandIndex1``.

    Returns:
        Left or right; empty if the names are ambiguous.
    """
    return _side_of_names([rig_name]) or _side_of_names(bone_names)


def _side_of_names(names: Iterable[str]) -> str:
    votes = dict.fromkeys(SIDES, 0)
    for name in names:
        for word in _words(name):
            for side in SIDES:
                if word == side[0] or word.startswith(side):
                    votes[side] += 1
    if votes["left"] == votes["right"]:
        return ""
    return max(SIDES, key=lambda side: votes[side])


def _words(name: str) -> list[str]:
    """Split a name, which may be in CamelCase, into lower-case words and numbers."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Za-z])(?=\d)|(?<=\d)(?=[A-Za-z])", " ", name)
    return [word.lower() for word in re.split(r"[^A-Za-z0-9]+", spaced) if word]


def _joint(name: str) -> int | None:
    words = _words(name)
    number = next((int(word) for word in words if word.isdigit()), None)
    kinds = [word for word in words if not word.isdigit()]
    finger = next((FINGER_WORDS[word] for word in kinds if word in FINGER_WORDS), None)
    if finger is None:
        rest = [word for word in kinds if word not in _FILLER_WORDS]
        if rest == ["wrist"] or (not rest and "hand" in kinds and number in (None, 0)):
            return WRIST
        if rest == ["palm"] and number is None:
            return PALM
        return None
    segment = next((_SEGMENT_WORDS[word] for word in kinds if word in _SEGMENT_WORDS), None)
    chain = FINGERS[finger]
    if segment is not None:
        segments = SEGMENTS if finger else THUMB_SEGMENTS
        return chain[segments.index(segment)] if segment in segments else None
    if number is None or not 0 <= number <= 4:
        return None
    # Numbers start at 1 with the thumb's metacarpal, and with the other fingers' proximal bones.
    index = number if finger else number - 1
    return chain[index] if 0 <= index < len(chain) else None
