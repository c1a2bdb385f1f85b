# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes the inside of a hand with tetrahedra, without connecting neighboring fingers.

If lattice cells are wider than the gap between fingers, tetrahedra reach into two fingers. Each
such tetrahedron is duplicated for every finger in it, with separate corners, as in Teran et al.,
"Creating and simulating skeletal muscle from the visible human data set", 2005,
10.1109/TVCG.2005.42 (virtual nodes). Duplicates share corners only where the palm joins them.
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
"""Smallest mean-ratio quality of a tetrahedron after the lattice's surface is moved to the skin."""
REACH = 2.0
"""Palm and finger are joined where the path along the skin between them is shorter [cells]."""

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
    """Tetrahedra of all parts; parts share nodes where the palm joins them."""
    part: NDArray[np.int32]
    """Part of the hand that each tetrahedron belongs to, shape [T]."""
    at_root: NDArray[np.bool_]
    """Whether it belongs to a finger and also holds palm around the finger's root, shape [T]."""


@dataclass(frozen=True)
class _Content:
    """The parts of the hand in each tetrahedron of the lattice."""

    share: NDArray[np.float64]
    """Share of its volume that each part fills, shape [T, 1 + F]."""
    palm_distance: NDArray[np.float64]
    """Shortest path along the skin from each finger's root to the palm in it [m], shape [T, F]."""
    finger_distance: NDArray[np.float64]
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
        skin: Distance queries on the skin.
        vertices: Vertices of the skin [m], shape [V, 3].
        faces: Triangles of the skin, shape [F, 3].
        parts: Division of the skin into palm and fingers.
        cell: Edge of the lattice's cubic cells [m].
    """
    lattice = _lattice_around(skin, vertices, cell)
    content, lattice = _content(skin, lattice, parts, cell)
    tetrahedron, part, fill, at_root = _copies(content, cell)
    filled = (part == PALM) & (fill >= MIN_FILL)
    key = _corner_keys(lattice, content, tetrahedron, part, tetrahedron[filled], cell)
    corners_of = np.unique(key, return_inverse=True)[1].reshape(key.shape)
    threshold = MIN_FILL
    while True:
        kept = fill >= threshold
        if _in_one_piece(corners_of[kept]) and np.isin(part, part[kept]).all():
            break
        # A finger thinner than the lattice has only tetrahedra with little flesh.
        threshold = 0.5 * threshold if threshold > 1e-3 else -1.0
        if threshold < 0.0:
            kept = np.ones(len(fill), bool)
            break
    used, corners = np.unique(key[kept], return_inverse=True)
    points = lattice.points[used // (1 + parts.finger_count)]
    flesh = Tetrahedra(points, corners.reshape(-1, 4).astype(np.int32))
    owner = (used % (1 + parts.finger_count)).astype(np.int32)
    points = _fitted_to_skin(flesh, owner, vertices, faces, parts, cell)
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
    """Find the parts in each tetrahedron, and drop empty tetrahedra."""
    center = skin.nearest(lattice.points[lattice.corners].mean(1))
    touched = center.depth > -_SAMPLE_REACH * cell
    corners, depth, nearest = (
        lattice.corners[touched],
        center.depth[touched],
        center.vertex[touched],
    )
    count, finger_count = len(corners), parts.finger_count
    share = np.zeros((count, 1 + finger_count))
    distance = np.full((2, count, finger_count), np.inf)
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
        distance[0, rows] = np.where(in_palm, beyond, np.inf).min(1)
        distance[1, rows] = np.where(on_finger, -beyond, np.inf).min(1)
    filled = share.any(1)
    content = _Content(share[filled], distance[0, filled], distance[1, filled])
    return content, Tetrahedra(lattice.points, corners[filled])


def _sampled(
    skin: SkinQuery, corners: NDArray[np.float64]
) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Nearest skin vertex of sample points, and whether they are inside, shape [T, samples]."""
    samples = np.einsum("sk,tkd->tsd", _SAMPLES, corners)
    found = skin.nearest(samples.reshape(-1, 3))
    shape = samples.shape[:2]
    return found.vertex.reshape(shape), (found.depth > 0.0).reshape(shape)


def _copies(
    content: _Content, cell: float
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float64], NDArray[np.bool_]]:
    """Tetrahedron, part and fill of every copy, and whether it joins a finger to the palm.

    Palm in the same tetrahedron as the root of a finger belongs to that finger's copy; palm that a
    finger merely touches, far from it along the skin, gets a separate copy.
    """
    joined = content.palm_distance + content.finger_distance < REACH * cell
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
    """Keys for the corners of copies; equal keys mean the same node, shape [copies, 4].

    A finger shares a corner with the palm if the corner is at the finger's root and belongs to a
    tetrahedron filled by the palm alone. All other corners belong to the finger only.
    """
    point_count, finger_count = len(lattice.points), content.palm_distance.shape[1]
    in_palm = np.zeros(point_count, bool)
    in_palm[lattice.corners[palm]] = True
    distance = np.full((2, point_count, finger_count), np.inf)
    for corner in lattice.corners.T:
        np.minimum.at(distance[0], corner, content.palm_distance)
        np.minimum.at(distance[1], corner, content.finger_distance)
    shared = np.column_stack(
        [np.ones(point_count, bool), in_palm[:, None] & (distance.sum(0) < REACH * cell)]
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


def _fitted_to_skin(
    flesh: Tetrahedra,
    owner: NDArray[np.int32],
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    parts: HandParts,
    cell: float,
) -> NDArray[np.float64]:
    """Move corners outside their part's skin onto it while tetrahedra stay well shaped.

    Corners stop slightly outside the skin, so that the volume that the flat faces cut off equals
    the volume they add. The tetrahedra then have the hand's volume, and protrude little where a
    finger bends.
    """
    offset = _offset_to_skin(flesh.points, owner, vertices, faces, parts, cell)
    length = np.linalg.norm(offset, axis=1, keepdims=True)
    volume, area = mesh_volume(vertices, faces), mesh_area(vertices, faces)
    margin = 0.0
    for _ in range(_MARGIN_ROUNDS):
        shortened = offset * np.maximum(1.0 - margin / np.maximum(length, 1e-12), 0.0)
        moved = _moved(flesh, shortened)
        missing = volume - float(tetrahedron_volumes(moved, flesh.corners).sum())
        margin = float(np.clip(margin + missing / area, 0.0, 0.3 * cell))
    return moved


def _offset_to_skin(
    points: NDArray[np.float64],
    owner: NDArray[np.int32],
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    parts: HandParts,
    cell: float,
) -> NDArray[np.float64]:
    """Offset to their part's skin for points outside it, zero for others [m], shape [N, 3]."""
    offsets = np.zeros_like(points)
    for number in range(1 + parts.finger_count):
        # The parts overlap at the roots, so that neither skin ends in an edge there.
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
        offsets[own] = np.where(outside[:, None], offset, 0.0)
    return offsets


def _moved(flesh: Tetrahedra, offset: NDArray[np.float64]) -> NDArray[np.float64]:
    """Corners moved along their offsets while tetrahedra stay well shaped [m], shape [N, 3]."""
    share = np.ones((len(offset), 1))
    for iteration in range(_SNAPS + 2):
        moved = flesh.points + share * offset
        poor = tetrahedron_qualities(moved, flesh.corners) < MIN_QUALITY
        if not poor.any():
            return moved
        share[flesh.corners[poor].ravel()] *= 0.7 if iteration < _SNAPS else 0.0
    return flesh.points
