# SPDX-License-Identifier: GPL-3.0-or-later
"""Which bone of a rig is which joint: OpenXR's, WebXR's and the usual animation rigs' names."""

from __future__ import annotations

import re
from collections.abc import Iterable

from ..protocol.joints import FINGERS, PALM, WRIST

_FINGER_WORDS = {
    "thumb": 0,
    "index": 1,
    "middle": 2,
    "mid": 2,
    "ring": 3,
    "little": 4,
    "pinky": 4,
    "pinkie": 4,
}
_SEGMENTS = ("metacarpal", "proximal", "intermediate", "distal", "tip")
_SEGMENT_WORDS = {
    "metacarpal": "metacarpal",
    "carpal": "metacarpal",
    "palm": "metacarpal",
    "proximal": "proximal",
    "knuckle": "proximal",
    "intermediate": "intermediate",
    "middlephalanx": "intermediate",
    "distal": "distal",
    "tip": "tip",
    "end": "tip",
}
_NOISE = frozenset(
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
_SIDE_WORDS = {"l": "left", "left": "left", "r": "right", "right": "right"}


def joints_of_bones(names: Iterable[str]) -> dict[str, int]:
    """Tell which joint each bone is.

    Args:
        names: The rig's bones, in its order; of several that could be one joint the first is it.

    Returns:
        The joint's number for each bone that is one.
    """
    joints: dict[str, int] = {}
    for name in names:
        joint = _joint(name)
        if joint is not None and joint not in joints.values():
            joints[name] = joint
    return joints


def side_of_bones(names: Iterable[str]) -> str:
    """The side that bones are named after, as in ``hand.L``; empty where none is."""
    votes = {"left": 0, "right": 0}
    for name in names:
        for word in _words(name):
            if word in _SIDE_WORDS:
                votes[_SIDE_WORDS[word]] += 1
    if votes["left"] == votes["right"]:
        return ""
    return max(votes, key=lambda side: votes[side])


def _words(name: str) -> list[str]:
    """Lower-case words and numbers of a name, also of one in CamelCase."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Za-z])(?=\d)|(?<=\d)(?=[A-Za-z])", " ", name)
    return [word.lower() for word in re.split(r"[^A-Za-z0-9]+", spaced) if word]


def _joint(name: str) -> int | None:
    words = _words(name)
    number = next((int(word) for word in words if word.isdigit()), None)
    kinds = [word for word in words if not word.isdigit()]
    finger = next((_FINGER_WORDS[word] for word in kinds if word in _FINGER_WORDS), None)
    if finger is None:
        rest = [word for word in kinds if word not in _NOISE]
        if rest == ["wrist"] or (not rest and "hand" in kinds and number in (None, 0)):
            return WRIST
        if rest == ["palm"] and number is None:
            return PALM
        return None
    segment = next((_SEGMENT_WORDS[word] for word in kinds if word in _SEGMENT_WORDS), None)
    chain = FINGERS[finger]
    if segment is not None:
        if finger == 0:
            # The thumb has no intermediate bone.
            names = ("metacarpal", "proximal", "distal", "tip")
            return chain[names.index(segment)] if segment in names else None
        return chain[_SEGMENTS.index(segment)]
    if number is None or not 0 <= number <= 4:
        return None
    # Numbered bones begin at the thumb's metacarpal, and at the other fingers' proximal bones.
    place = number if finger else number - 1
    return chain[place] if 0 <= place < len(chain) else None
