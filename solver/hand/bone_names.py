# SPDX-License-Identifier: GPL-3.0-or-later
"""Finding parents of loose bones by name: headsets deliver hands as 25 or 26 separate joints."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

_FINGER = re.compile(r"thumb|index|middle|ring|little|pinky")
_SEGMENTS = ("metacarpal", "proximal", "intermediate", "distal", "tip")
_WRIST = re.compile(r"(^|[^a-z])(wrist|hand)([^a-z]|$)")


def named_parents(names: tuple[str, ...]) -> NDArray[np.int32]:
    """Chain bones by the words of OpenXR and WebXR, such as index-finger-phalanx-proximal.

    Returns:
        Index of each bone's parent, -1 for a root, shape [B]. Bones with other names stay roots;
        all do if no bone is the wrist, or several are, or a name occurs twice.
    """
    lowered = [name.lower() for name in names]
    parents = np.full(len(names), -1, np.int32)
    wrists: list[int] = []
    chains: dict[str, dict[int, int]] = {}
    for bone, name in enumerate(lowered):
        finger = _FINGER.search(name)
        segment = next((n for n, word in enumerate(_SEGMENTS) if word in name), None)
        if finger is None and _WRIST.search(name):
            wrists.append(bone)
        elif finger is not None and segment is not None:
            chain = chains.setdefault(finger.group(), {})
            if segment in chain:
                return parents
            chain[segment] = bone
    if len(wrists) != 1:
        return parents
    for chain in chains.values():
        before = wrists[0]
        for segment in sorted(chain):
            parents[chain[segment]] = before
            before = chain[segment]
    for bone, name in enumerate(lowered):
        if name == "palm":
            parents[bone] = wrists[0]
    return parents
