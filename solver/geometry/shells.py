# SPDX-License-Identifier: GPL-3.0-or-later
"""Shells of a mesh: connected closed surfaces, which may lie beside, inside or across each other.

A shell's winding alone does not tell whether it is a body, a cavity or a mistake; that depends on
where it lies. A shell outside all others is a body whichever way it is wound. One inside another is
a cavity if it is wound the opposite way, and otherwise a body within a body.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_SAMPLE_COUNT = 7
"""Number of corners tested to decide whether one shell lies inside another."""
_CHUNK = 2_000_000


def connected_labels(pairs: NDArray[np.integer], count: int) -> NDArray[np.int64]:
    """Label the connected components of a graph.

    Args:
        pairs: Connected nodes, shape [P, 2].
        count: Number of nodes.

    Returns:
        Component of each node, from 0, shape [count].
    """
    label = np.arange(count)
    first, second = np.asarray(pairs, np.int64).reshape(-1, 2).T
    while True:
        one, two = label[first], label[second]
        if np.array_equal(one, two):
            return np.unique(label, return_inverse=True)[1].reshape(-1)
        # Each root hooks onto the lowest root it touches, then every chain is cut short.
        np.minimum.at(label, np.maximum(one, two), np.minimum(one, two))
        while not np.array_equal(label, shorter := label[label]):
            label = shorter


def face_edges(faces: NDArray[np.integer]) -> NDArray[np.int64]:
    """Directed edges of triangles, three per face in order, shape [3 F, 2]."""
    return faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)


def edge_pairs(faces: NDArray[np.integer]) -> NDArray[np.int64]:
    """Pairs of faces that share an edge with no third face, shape [P, 2].

    Args:
        faces: Corner indices, shape [F, 3].
    """
    order, begin, uses = _edge_groups(faces)
    first = begin[uses == 2]
    return np.stack([order[first], order[first + 1]], 1) // 3


def _edge_groups(
    faces: NDArray[np.integer],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Group equal edges: their order by group, the start of each group, and its size."""
    ends = np.sort(face_edges(faces), axis=1)
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    ordered = ends[order]
    begin = np.flatnonzero(np.r_[True, (ordered[1:] != ordered[:-1]).any(1)])
    return order, begin, np.diff(np.r_[begin, len(ordered)])


def shell_labels(
    faces: NDArray[np.integer], known: NDArray[np.integer] | None = None
) -> NDArray[np.int64]:
    """Shell of each face, from 0, shape [F].

    Two faces that share an edge with no third face belong to the same shell. Bodies that merely
    touch along an edge are therefore separate shells, as long as each is closed by itself.

    Args:
        faces: Corner indices, shape [F, 3].
        known: Pairs of faces that belong together regardless, shape [P, 2].
    """
    pairs = edge_pairs(faces)
    if known is not None:
        pairs = np.concatenate([pairs, known])
    label = connected_labels(pairs, len(faces))
    order, begin, uses = _edge_groups(faces)
    group = np.repeat(np.arange(len(begin)), uses)
    owner = label[order // 3]
    # A group that is open by itself at an edge of many faces belongs to the others there.
    _, place, count = np.unique(
        group * (int(label.max()) + 1) + owner, return_inverse=True, return_counts=True
    )
    loose = np.unique(group[count[place.reshape(-1)] % 2 == 1])
    if not len(loose):
        return label
    more = np.flatnonzero(np.isin(group, loose[uses[loose] > 1]))
    chained = more[1:][group[more[1:]] == group[more[:-1]]]
    joined = np.stack([order[chained], order[chained - 1]], 1) // 3
    return connected_labels(np.concatenate([pairs, joined]), len(faces))


def shell_volumes(
    vertices: NDArray[np.float64], faces: NDArray[np.integer], label: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Signed volume of each shell [m³].

    Args:
        vertices: Corner positions [m], shape [V, 3].
        faces: Corner indices, shape [F, 3].
        label: Shell of each face, shape [F].
    """
    count = int(label.max()) + 1
    # Relative to one of its corners: far from the origin, cancellation would lose precision.
    corner = np.zeros((count, 3))
    corner[label] = vertices[faces[:, 0]]
    first, second, third = (vertices[faces[:, k]] - corner[label] for k in range(3))
    parts = np.einsum("ij,ij->i", first, np.cross(second, third)) / 6.0
    return np.bincount(label, weights=parts, minlength=count)


def winding_number(
    points: NDArray[np.float64], vertices: NDArray[np.float64], faces: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Winding number of a closed mesh around points; 1 inside a body, 0 outside, shape [N].

    A sum of solid angles (van Oosterom and Strackee, 10.1109/TBME.1983.325207): exact, unlike rays
    that may hit an edge.

    Args:
        points: Points [m], shape [N, 3].
        vertices: Corner positions [m], shape [V, 3].
        faces: Corner indices, shape [F, 3].
    """
    winding = np.zeros(len(points))
    step = max(1, _CHUNK // max(len(faces), 1))
    for start in range(0, len(points), step):
        part = points[start : start + step, None]
        a, b, c = (vertices[faces[:, k]][None] - part for k in range(3))
        la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
        top = np.einsum("nfi,nfi->nf", a, np.cross(b, c))
        bottom = la * lb * lc
        for one, two, length in ((a, b, lc), (b, c, la), (c, a, lb)):
            bottom = bottom + np.einsum("nfi,nfi->nf", one, two) * length
        winding[start : start + step] = np.arctan2(top, bottom).sum(1) / (2.0 * np.pi)
    return winding


def shell_signs(
    vertices: NDArray[np.float64],
    faces: NDArray[np.integer],
    label: NDArray[np.integer],
    volumes: NDArray[np.float64],
) -> NDArray[np.int64]:
    """Whether each shell is a body (1) or a cavity in the body around it (-1), shape [S].

    Args:
        vertices: Corner positions [m], shape [V, 3].
        faces: Corner indices, shape [F, 3].
        label: Shell of each face, shape [F].
        volumes: Signed volume of each shell as it is wound [m³], shape [S].
    """
    count = len(volumes)
    sign = np.ones(count, np.int64)
    if count == 1:
        return sign
    order = np.argsort(label, kind="stable")
    by_shell = np.split(faces[order], np.cumsum(np.bincount(label, minlength=count))[:-1])
    low = np.array([vertices[part].min((0, 1)) for part in by_shell])
    high = np.array([vertices[part].max((0, 1)) for part in by_shell])
    # From large to small, so that the shells around one are decided before it.
    for shell in np.argsort(-np.abs(volumes), kind="stable"):
        around = (low <= low[shell]).all(1) & (high >= high[shell]).all(1)
        around &= np.abs(volumes) > abs(volumes[shell])
        corners = np.unique(by_shell[shell])
        samples = vertices[corners[np.linspace(0, len(corners) - 1, _SAMPLE_COUNT).astype(int)]]
        parents = [
            other
            for other in np.flatnonzero(around)
            if (np.abs(winding_number(samples, vertices, by_shell[other])) > 0.5).all()
        ]
        if parents:
            parent = min(parents, key=lambda other: abs(volumes[other]))
            same = np.sign(volumes[shell]) == np.sign(volumes[parent])
            # A shell in a cavity is a body again; a body within a body merges with it.
            sign[shell] = sign[parent] if same else -sign[parent]
    return sign
