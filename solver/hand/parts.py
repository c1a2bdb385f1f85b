# SPDX-License-Identifier: GPL-3.0-or-later
"""Divides the skin of a hand into freely moving fingers and the palm that joins them.

Only the shape of the skin is used, so that any skeleton and rough weights will do. The distance
along the skin from the wrist has a peak at every fingertip. Persistent peaks are fingers
(Edelsbrunner, Letscher and Zomorodian, "Topological persistence and simplification", 2002,
10.1007/s00454-002-2885-2); each is free down to the point where the shortest path to the nearest
fingertip leaves it. Distances along the skin also separate fingers that merely touch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

PALM = 0
"""Index of the part that holds all skin outside free fingers."""

_PERSISTENCE = (0.06, 0.03)
"""Smallest length of a free end, relative to the distance from the wrist to the farthest tip. The
second is for slender ends, such as fingers at the end of a long arm."""
_SLENDER = 1.7
"""Smallest π length² / area of a slender end; a round cap has 1, a finger 2 to 3."""
_END_REACH = 0.12
"""Radius around an end in which its skin area is measured, relative to the largest distance along
the skin."""


@dataclass(frozen=True)
class HandParts:
    """Division of the skin into the palm and F free fingers."""

    part: NDArray[np.int32]
    """PALM, or 1 + the index of the free finger that a vertex belongs to, shape [V]."""
    beyond: NDArray[np.float64]
    """Distance along the skin of each vertex from the root of each free finger, negative on the
    finger [m], shape [V, F]."""

    @property
    def finger_count(self) -> int:
        """Number F of free fingers."""
        return self.beyond.shape[1]


def hand_parts(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> HandParts:
    """Divide a skin into palm and fingers.

    Args:
        vertices: Vertices of the skin [m], shape [V, 3].
        faces: Triangles of the closed skin, shape [F, 3], all in one piece.
    """
    edges = skin_edges(faces)
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    corners = np.moveaxis(vertices[faces], 1, 0)
    area = 0.5 * np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]), axis=1)
    areas = np.bincount(faces.ravel(), np.repeat(area / 3.0, 3), minlength=len(vertices))
    height = distances_from(_wrist(edges, lengths, areas), edges, lengths)
    tips = _free_ends(height, edges, areas)
    distances = [distances_from(tip, edges, lengths) for tip in tips]
    part = np.full(len(vertices), PALM, np.int32)
    beyond = np.zeros((len(vertices), len(tips)))
    for finger, distance in enumerate(distances):
        roots = [
            distance[_web(distance, other, height)]
            for second, other in enumerate(distances)
            if second != finger
        ]
        beyond[:, finger] = distance - min(roots)
        part[beyond[:, finger] < 0.0] = 1 + finger
    return HandParts(part, beyond)


def _web(
    first: NDArray[np.float64], second: NDArray[np.float64], height: NDArray[np.float64]
) -> int:
    """The vertex on the shortest path between two fingertips that is nearest to the wrist."""
    total = first + second
    on_path = total <= total.min() * (1.0 + 1e-9)
    return int(np.where(on_path, height, np.inf).argmin())


def skin_edges(faces: NDArray[np.int32]) -> NDArray[np.int64]:
    """Every edge of a closed skin, in both directions, sorted, shape [E, 2]."""
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    count = int(faces.max()) + 1
    keys = np.unique(np.concatenate([directed @ (count, 1), directed @ (1, count)]))
    return np.stack([keys // count, keys % count], axis=1)


def skin_pieces(count: int, edges: NDArray[np.int64]) -> NDArray[np.int64]:
    """The connected piece of each vertex, identified by its lowest vertex index, shape [V]."""
    piece = np.arange(count)
    while True:
        before = piece.copy()
        np.minimum.at(piece, edges[:, 0], piece[edges[:, 1]])
        piece = piece[piece]
        if np.array_equal(piece, before):
            return piece


def distances_from(
    start: int, edges: NDArray[np.int64], lengths: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Lengths of the shortest paths along edges from a vertex to all vertices [m], shape [V].

    Args:
        start: Index of the vertex.
        edges: Edges in both directions, sorted, shape [E, 2].
        lengths: Their lengths [m], shape [E].
    """
    count = int(edges.max()) + 1
    first = np.searchsorted(edges[:, 0], np.arange(count + 1))
    distance = np.full(count, np.inf)
    distance[start] = 0.0
    changed = np.zeros(count, bool)
    front = np.array([start])
    while len(front):
        degree = first[front + 1] - first[front]
        # Indices of the front's edges, vertex by vertex.
        edge = np.repeat(first[front] - np.cumsum(degree) + degree, degree)
        edge += np.arange(len(edge))
        reached, candidate = edges[edge, 1], distance[edges[edge, 0]] + lengths[edge]
        shorter = candidate < distance[reached]
        np.minimum.at(distance, reached[shorter], candidate[shorter])
        changed[:] = False
        changed[reached[shorter]] = True
        front = np.flatnonzero(changed)
    return distance


def _wrist(
    edges: NDArray[np.int64], lengths: NDArray[np.float64], areas: NDArray[np.float64]
) -> int:
    """The end of the hand with the most skin around it: an arm is thicker than a finger."""
    first_end = int(distances_from(0, edges, lengths).argmax())
    height = distances_from(first_end, edges, lengths)
    others = {int(height.argmax()), *_free_ends(height, edges, areas)}
    ends = [first_end, *sorted(others)]
    distances = [distances_from(end, edges, lengths) for end in ends]
    reach = _END_REACH * float(np.max(distances))
    return ends[int(np.argmax([areas[distance < reach].sum() for distance in distances]))]


@dataclass
class _End:
    """A connected piece of skin above some height, grown downward from its highest vertex."""

    peak: int
    members: list[int]
    area: float = 0.0
    merged: bool = False
    """Whether persistent ends have merged into it."""


def _free_ends(
    height: NDArray[np.float64], edges: NDArray[np.int64], areas: NDArray[np.float64]
) -> list[int]:
    """Highest vertex of each end that is persistent when it meets another persistent end.

    Args:
        height: Distance of each vertex from the wrist along the skin [m], shape [V].
        edges: Edges in both directions, sorted, shape [E, 2].
        areas: Area of skin around each vertex [m²], shape [V].
    """
    long, short = (share * float(height.max()) for share in _PERSISTENCE)
    start = np.searchsorted(edges[:, 0], np.arange(len(height) + 1))
    group = np.full(len(height), -1, np.int64)
    ends: dict[int, _End] = {}
    free: list[int] = []
    for vertex in np.argsort(-height, kind="stable").tolist():
        around = set(group[edges[start[vertex] : start[vertex + 1], 1]].tolist()) - {-1}
        if not around:
            around = {vertex}
            ends[vertex] = _End(vertex, [])
        into = max(around, key=lambda number: len(ends[number].members))
        if len(around) > 1:
            persistent = []
            for number in around:
                end = ends[number]
                length = float(height[end.peak] - height[vertex])
                slender = length**2 > _SLENDER * end.area / np.pi
                if end.merged or length >= long or (length >= short and slender):
                    persistent.append(end)
            if len(persistent) > 1:
                free += [end.peak for end in persistent if not end.merged]
            for number in around - {into}:
                other = ends.pop(number)
                group[other.members] = into
                ends[into].members += other.members
                ends[into].area += other.area
                ends[into].merged |= other.merged
                ends[into].peak = max(ends[into].peak, other.peak, key=lambda v: height[v])
            ends[into].merged |= len(persistent) > 1
        group[vertex] = into
        ends[into].members.append(vertex)
        ends[into].area += float(areas[vertex])
    return free
