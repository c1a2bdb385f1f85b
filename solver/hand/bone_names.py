# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the parents of loose bones by name: headsets deliver hands as 25 or 26 separate joints."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from .proportions import SEGMENTS

FINGER_WORDS = {
    "thumb": 0,
    "index": 1,
    "middle": 2,
    "mid": 2,
    "ring": 3,
    "little": 4,
    "pinky": 4,
    "pinkie": 4,
}
"""Words for fingers in the names of bones, and the finger's index, starting with the thumb."""

_FINGER = re.compile("|".join(FINGER_WORDS))
_WRIST = re.compile(r"(^|[^a-z])wrist([^a-z]|$)")
_HAND = re.compile(r"(^|[^a-z])hand([^a-z]|$)")
"""In some rigs the wrist's bone is called hand; in OpenXR every bone is a joint of a hand."""
_PALM = re.compile(r"(^|[^a-z])palm([^a-z]|$)")
_ARM = re.compile(r"(^|[^a-z])(forearm|elbow)([^a-z]|$)")
_CAMEL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")


def named_parents(names: tuple[str, ...]) -> NDArray[np.int32]:
    """Chain bones named as in OpenXR or WebXR, such as index-finger-phalanx-proximal.

    Returns:
        Index of each bone's parent, -1 for a root, shape [B]. Bones with other names stay roots,
        fingers with numbers for segments among them; all do if there is no wrist, more than one,
        or a finger has a segment twice.
    """
    lowered = [name.lower() for name in names]
    parents = np.full(len(names), -1, np.int32)
    wrists: list[int] = []
    palms: list[int] = []
    chains: dict[int, dict[int, int]] = {}
    for bone, name in enumerate(lowered):
        finger = _FINGER.search(name)
        segment = next((index for index, word in enumerate(SEGMENTS) if word in name), None)
        if finger is None:
            part = _part(names[bone])
            if part == "wrist":
                wrists.append(bone)
            elif part == "palm":
                palms.append(bone)
        elif segment is not None:
            chain = chains.setdefault(FINGER_WORDS[finger.group()], {})
            if segment in chain:
                return parents
            chain[segment] = bone
    if len(wrists) != 1:
        return parents
    for chain in chains.values():
        parent = wrists[0]
        for segment in sorted(chain):
            parents[chain[segment]] = parent
            parent = chain[segment]
    parents[palms] = wrists[0]
    return parents


def _part(name: str) -> str:
    """Whether a bone that belongs to no finger is the wrist or in the palm; empty if neither."""
    # LeftHand is a hand as left_hand is.
    words = _CAMEL.sub("_", name).lower()
    if _WRIST.search(words):
        return "wrist"
    if _PALM.search(words):
        return "palm"
    return "wrist" if _HAND.search(words) and not _ARM.search(words) else ""
