# SPDX-License-Identifier: GPL-3.0-or-later
"""Parents of bones that have none: hands from headsets often come as 25 loose joints.

Known names say which bone follows which; for other names, bones whose skin borders on each other
most are neighbours.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

_FINGER = re.compile(r"thumb|index|middle|ring|little|pinky")
_SEGMENTS = ("metacarpal", "proximal", "intermediate", "distal", "tip")
_WRIST = re.compile(r"(^|[^a-z])(wrist|hand)([^a-z]|$)")


def inferred_parents(
    names: tuple[str, ...],
    places: NDArray[np.float64],
    weights: NDArray[np.float64],
    edges: NDArray[np.int64],
) -> NDArray[np.int32]:
    """Find a skeleton for loose bones.

    Args:
        names: Names of the bones.
        places: Where they are [m], shape [B, 3].
        weights: How much each carries each vertex of the skin, shape [V, B].
        edges: Edges of the skin in both directions, shape [E, 2].

    Returns:
        Index of each bone's parent, -1 for the root, shape [B].
    """
    named = _by_name(names)
    return named if named is not None else _by_borders(places, weights, edges)


def _by_name(names: tuple[str, ...]) -> NDArray[np.int32] | None:
    """Parents by the words of OpenXR and WebXR; None where the names are others."""
    lowered = [name.lower() for name in names]
    fingers = [_FINGER.search(name) for name in lowered]
    segments = [next((s for s in _SEGMENTS if s in name), None) for name in lowered]
    wrists = [
        bone
        for bone, name in enumerate(lowered)
        if fingers[bone] is None and _WRIST.search(name) is not None
    ]
    known = [
        finger is not None and segment is not None
        for finger, segment in zip(fingers, segments, strict=True)
    ]
    if len(wrists) != 1 or sum(known) < 2:
        return None
    root = wrists[0]
    parents = np.full(len(names), root, np.int32)
    parents[root] = -1
    chains: dict[str, list[tuple[int, int]]] = {}
    for bone, (finger, segment) in enumerate(zip(fingers, segments, strict=True)):
        if finger is not None and segment is not None:
            place = _SEGMENTS.index(segment)
            chains.setdefault(finger.group(), []).append((place, bone))
    for chain in chains.values():
        bones = [bone for _, bone in sorted(chain)]
        if len({place for place, _ in chain}) < len(chain):
            return None
        parents[bones[1:]] = bones[:-1]
    return parents


def _by_borders(
    places: NDArray[np.float64], weights: NDArray[np.float64], edges: NDArray[np.int64]
) -> NDArray[np.int32]:
    """Parents by a spanning tree of the longest borders between the skin of bones."""
    count = weights.shape[1]
    strongest = weights.argmax(1)
    border = np.zeros((count, count))
    np.add.at(border, (strongest[edges[:, 0]], strongest[edges[:, 1]]), 1.0)
    np.fill_diagonal(border, 0.0)
    area = np.bincount(strongest, minlength=count)
    tree = np.zeros((count, count), bool)
    reached = np.zeros(count, bool)
    reached[area.argmax()] = True
    while True:
        ahead = np.where(reached[:, None] & ~reached[None, :], border, 0.0)
        if not ahead.any():
            break
        first, second = np.unravel_index(ahead.argmax(), ahead.shape)
        tree[first, second] = tree[second, first] = reached[second] = True
    root = int((tree.sum(1) * 1e9 + area).argmax())
    parents = np.full(count, -1, np.int32)
    known, waiting = {root}, [root]
    while waiting:
        bone = waiting.pop()
        for other in np.flatnonzero(tree[bone]):
            if int(other) not in known:
                parents[other] = bone
                known.add(int(other))
                waiting.append(int(other))
    # Bones that carry no skin hang on the nearest that does.
    carrying = np.array(sorted(known))
    for bone in set(range(count)) - known:
        way = np.linalg.norm(places[carrying] - places[bone], axis=1)
        parents[bone] = carrying[way.argmin()]
    return parents
