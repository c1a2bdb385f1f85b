# SPDX-License-Identifier: GPL-3.0-or-later
"""The inside of a hand as tetrahedra, none of which two fingers share.

A lattice with cells wider than the gap between fingers has tetrahedra that reach into two fingers.
Each such tetrahedron is copied for every finger in it, with corners of its own, as in Teran et al.,
"Creating and simulating skeletal muscle from the visible human data set", 2005,
10.1109/TVCG.2005.42 (virtual nodes). Copies share corners only where the palm joins them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry.closed_mesh import mesh_area, mesh_volume
from ..geometry.lattice_tetrahedra import (
    Tetrahedra,
    lattice_tetrahedra,
    tetrahedron_qualities,
    tetrahedron_volumes,
)
from ..geometry.skin_query import SkinQuery
from .parts import PALM, HandParts, skin_pieces

MIN_FILL = 0.2
"""Tetrahedra are dropped if less than this share of their volume is flesh."""
MIN_QUALITY = 0.4
"""Smallest mean ratio of a tetrahedron after the lattice's surface is moved onto the skin."""
REACH = 2.0
"""Palm and finger are joined where the path between them along the skin is shorter [cells]."""

_SAMPLE_REACH = 0.75 * np.sqrt(5.0) / 4.0
"""Largest distance of a sample from the center of its tetrahedron, in cells."""
_SAMPLES = np.array(
    [(i, j, k, 3 - i - j - k) for i in range(4) for j in range(4 - i) for k in range(4 - i - j)]
)
_SAMPLES = (_SAMPLES + 0.25) / 4.0
_SNAPS = 8
_MARGIN_ROUNDS = 3


@dataclass(frozen=True)
class FleshMesh:
    """Tetrahedra inside a hand."""

    tetrahedra: Tetrahedra
    """Every part has its own; they share nodes where the palm joins them."""
    part: NDArray[np.int32]
    """Part of the hand that each tetrahedron belongs to, shape [T]."""
    at_root: NDArray[np.bool_]
    """Whether it belongs to a finger and also holds palm around the finger's root, shape [T]."""


@dataclass(frozen=True)
class _Content:
    """What is in each tetrahedron of the lattice."""

    share: NDArray[np.float64]
    """Share of its volume that each part fills, shape [T, 1 + F]."""
    palm_way: NDArray[np.float64]
    """Shortest path along the skin from each finger's root to the palm in it [m], shape [T, F]."""
    finger_way: NDArray[np.float64]
    """Shortest path from each finger in it to that finger's root [m], shape [T, F]."""


def hand_flesh(
    skin: SkinQuery,
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    parts: HandParts,
    cell: float,
) -> FleshMesh:
    """Fill a hand with tetrahedra.

    Args:
        skin: The skin.
        vertices: Its vertices [m], shape [V, 3].
        faces: Its triangles, shape [F, 3].
        parts: How it is divided into palm and fingers.
        cell: Edge of the lattice's cubic cells [m].
    """
    lattice = _lattice_around(skin, vertices, cell)
    content, lattice = _content(skin, lattice, parts, cell)
    tetrahedron, part, fill, at_root = _copies(content, cell)
    filled = (part == PALM) & (fill >= MIN_FILL)
    key = _corner_keys(lattice, content, tetrahedron, part, tetrahedron[filled], cell)
    corners_of = np.unique(key, return_inverse=True)[1].reshape(key.shape)
    least = MIN_FILL
    while True:
        kept = fill >= least
        if _in_one_piece(corners_of[kept]) and np.isin(part, part[kept]).all():
            break
        # A finger thinner than the lattice has only tetrahedra with little flesh.
        least = 0.5 * least if least > 1e-3 else -1.0
        if least < 0.0:
            kept = np.ones(len(fill), bool)
            break
    used, corners = np.unique(key[kept], return_inverse=True)
    points = lattice.points[used // (1 + parts.finger_count)]
    flesh = Tetrahedra(points, corners.reshape(-1, 4).astype(np.int32))
    owner = (used % (1 + parts.finger_count)).astype(np.int32)
    points = _laid_on_skin(flesh, owner, vertices, faces, parts, cell)
    return FleshMesh(Tetrahedra(points, flesh.corners), part[kept], at_root[kept])


def _lattice_around(skin: SkinQuery, vertices: NDArray[np.float64], cell: float) -> Tetrahedra:
    """Tetrahedra of all lattice cells that may contain part of the hand."""
    low = vertices.min(0)
    shape = np.maximum(np.ceil(np.ptp(vertices, axis=0) / cell).astype(int), 1)
    low = low - 0.5 * (shape * cell - np.ptp(vertices, axis=0))
    centers = low + cell * (np.indices(shape.tolist()).reshape(3, -1).T + 0.5)
    near = skin.nearest(centers).depth > -0.5 * np.sqrt(3.0) * cell
    return lattice_tetrahedra(low, near.reshape(shape), cell)


def _content(
    skin: SkinQuery, lattice: Tetrahedra, parts: HandParts, cell: float
) -> tuple[_Content, Tetrahedra]:
    """Find what is in each tetrahedron, and drop those that are empty."""
    center = skin.nearest(lattice.points[lattice.corners].mean(1))
    touched = center.depth > -_SAMPLE_REACH * cell
    corners, depth, nearest = (
        lattice.corners[touched],
        center.depth[touched],
        center.vertex[touched],
    )
    count, finger_count = len(corners), parts.finger_count
    share = np.zeros((count, 1 + finger_count))
    way = np.full((2, count, finger_count), np.inf)
    full = depth > _SAMPLE_REACH * cell
    for rows, vertices, inside in (
        (np.flatnonzero(full), nearest[full][:, None], np.ones((int(full.sum()), 1), bool)),
        (np.flatnonzero(~full), *_sampled(skin, lattice.points[corners[~full]])),
    ):
        part, beyond = parts.part[vertices], parts.beyond[vertices]
        for number in range(1 + finger_count):
            share[rows, number] = (inside & (part == number)).mean(1)
        in_palm = (inside & (part == PALM))[..., None]
        on_finger = inside[..., None] & (part[..., None] == np.arange(1, 1 + finger_count))
        way[0, rows] = np.where(in_palm, beyond, np.inf).min(1)
        way[1, rows] = np.where(on_finger, -beyond, np.inf).min(1)
    some = share.any(1)
    content = _Content(share[some], way[0, some], way[1, some])
    return content, Tetrahedra(lattice.points, corners[some])


def _sampled(
    skin: SkinQuery, place: NDArray[np.float64]
) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Nearest skin vertex of tetrahedron samples, and whether they are inside, [T, samples]."""
    samples = np.einsum("sk,tkd->tsd", _SAMPLES, place)
    found = skin.nearest(samples.reshape(-1, 3))
    shape = samples.shape[:2]
    return found.vertex.reshape(shape), (found.depth > 0.0).reshape(shape)


def _copies(
    content: _Content, cell: float
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float64], NDArray[np.bool_]]:
    """Tetrahedron, part and fill of every copy, and whether it joins a finger to the palm.

    Palm in the same tetrahedron as the root of a finger goes with it; palm that a finger merely
    touches, far from it along the skin, has a copy of its own.
    """
    joined = content.palm_way + content.finger_way < REACH * cell
    fill = content.share.copy()
    fill[:, 1:] += np.where(joined, content.share[:, :1], 0.0)
    fill[joined.any(1), PALM] = 0.0
    tetrahedron, part = np.nonzero(fill)
    at_root = np.column_stack([np.zeros(len(fill), bool), joined])
    chosen = (tetrahedron, part)
    return tetrahedron, part.astype(np.int32), fill[chosen], at_root[chosen]


def _corner_keys(
    lattice: Tetrahedra,
    content: _Content,
    tetrahedron: NDArray[np.int64],
    part: NDArray[np.int32],
    palm: NDArray[np.int64],
    cell: float,
) -> NDArray[np.int64]:
    """Number the corners of copies: equal numbers are the same node, shape [copies, 4].

    A finger shares a corner with the palm where the corner is at the finger's root and belongs to a
    tetrahedron that the palm alone fills. All its other corners are its own.
    """
    point_count, finger_count = len(lattice.points), content.palm_way.shape[1]
    in_palm = np.zeros(point_count, bool)
    in_palm[lattice.corners[palm]] = True
    way = np.full((2, point_count, finger_count), np.inf)
    for corner in lattice.corners.T:
        np.minimum.at(way[0], corner, content.palm_way)
        np.minimum.at(way[1], corner, content.finger_way)
    shared = np.column_stack(
        [np.ones(point_count, bool), in_palm[:, None] & (way.sum(0) < REACH * cell)]
    )
    corners = lattice.corners[tetrahedron].astype(np.int64)
    owner = np.where(shared[corners, part[:, None]], PALM, part[:, None])
    return corners * (1 + finger_count) + owner


def _in_one_piece(corners: NDArray[np.integer]) -> bool:
    """Whether the tetrahedra are all connected."""
    used, index = np.unique(corners, return_inverse=True)
    ring = index.reshape(-1, 4)
    edges = np.concatenate([ring[:, [i, (i + 1) % 4]] for i in range(4)])
    piece = skin_pieces(len(used), np.concatenate([edges, edges[:, ::-1]]))
    return len(used) > 0 and not piece.any()


def _laid_on_skin(
    flesh: Tetrahedra,
    owner: NDArray[np.int32],
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    parts: HandParts,
    cell: float,
) -> NDArray[np.float64]:
    """Move corners outside their part's skin onto it, as far as tetrahedra stay well shaped.

    They stop slightly outside, where the flat faces between them cut off as much as they add. The
    tetrahedra then have the hand's volume, and little sticks out where a finger bends.
    """
    way = _way_to_skin(flesh.points, owner, vertices, faces, parts, cell)
    length = np.linalg.norm(way, axis=1, keepdims=True)
    volume, area = mesh_volume(vertices, faces), mesh_area(vertices, faces)
    margin = 0.0
    for _ in range(_MARGIN_ROUNDS):
        stop = way * np.maximum(1.0 - margin / np.maximum(length, 1e-12), 0.0)
        moved = _moved(flesh, stop)
        lacking = volume - float(tetrahedron_volumes(moved, flesh.corners).sum())
        margin = float(np.clip(margin + lacking / area, 0.0, 0.3 * cell))
    return moved


def _way_to_skin(
    points: NDArray[np.float64],
    owner: NDArray[np.int32],
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    parts: HandParts,
    cell: float,
) -> NDArray[np.float64]:
    """Offset to their part's skin for points outside it, zero for others [m], shape [N, 3]."""
    way = np.zeros_like(points)
    for number in range(1 + parts.finger_count):
        # Overlap at the roots, so that neither part's skin ends in an edge there.
        if number == PALM:
            belongs = (parts.part == PALM) | (parts.beyond > -REACH * cell).any(1)
        else:
            belongs = (parts.part == number) | (
                (parts.beyond[:, number - 1] < REACH * cell) & (parts.part == PALM)
            )
        own = np.flatnonzero(owner == number)
        chosen = faces[belongs[faces].any(1)]
        if not len(own) or not len(chosen):
            continue
        found = SkinQuery(vertices, chosen).nearest(points[own])
        corner = vertices[chosen[found.face]]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        offset = found.place - points[own]
        outside = np.einsum("ij,ij->i", offset, normal) < 0.0
        way[own] = np.where(outside[:, None], offset, 0.0)
    return way


def _moved(flesh: Tetrahedra, way: NDArray[np.float64]) -> NDArray[np.float64]:
    """Corners moved along their offsets as far as tetrahedra stay well shaped [m], shape [N, 3]."""
    share = np.ones((len(way), 1))
    for turn in range(_SNAPS + 2):
        moved = flesh.points + share * way
        poor = tetrahedron_qualities(moved, flesh.corners) < MIN_QUALITY
        if not poor.any():
            return moved
        share[flesh.corners[poor].ravel()] *= 0.7 if turn < _SNAPS else 0.0
    return flesh.points
