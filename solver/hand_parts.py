# SPDX-License-Identifier: GPL-3.0-or-later
"""Which skin belongs to a finger that moves freely, and which to the palm that joins them.

Nothing here knows the names of bones. A finger is a chain of bones up to where the skeleton
branches; it is free from its tip to where its skin first meets that of another chain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

PALM = 0
"""Part of all skin that is not a free finger's."""

_SHORTEST = 0.02
"""A free end shorter than this share of the hand's length is none."""


@dataclass(frozen=True)
class HandParts:
    """How the skin is divided into the palm and F free fingers."""

    part: NDArray[np.int32]
    """PALM, or 1 + the free finger that a vertex belongs to, shape [V]."""
    chain: NDArray[np.int32]
    """1 + the finger whose bones carry a vertex, be it free or not, or PALM, shape [V]."""
    beyond: NDArray[np.float64]
    """How far along the skin a vertex lies beyond the root of each free finger, negative on the
    finger [m], shape [V, F]."""

    @property
    def finger_count(self) -> int:
        """Number F of free fingers."""
        return self.beyond.shape[1]


def hand_parts(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    weights: NDArray[np.float64],
    parents: NDArray[np.int32],
) -> HandParts:
    """Divide a skin.

    Args:
        vertices: Skin [m], shape [V, 3].
        faces: Triangles of the closed skin, shape [F, 3].
        weights: How much each bone carries each vertex, shape [V, B].
        parents: Index of each bone's parent, -1 for a root, shape [B].
    """
    edges = skin_edges(faces)
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    chains = finger_chains(weights, parents)
    shares = np.stack(
        [weights.sum(1) - weights[:, np.concatenate([*chains, []]).astype(int)].sum(1)]
        + [weights[:, chain].sum(1) for chain in chains],
        axis=1,
    )
    chain = _without_islands(shares.argmax(1).astype(np.int32), edges)
    part = np.full(len(vertices), PALM, np.int32)
    least = _SHORTEST * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    beyond = []
    for number in range(1, len(chains) + 1):
        own = chain == number
        at_border = own[edges[:, 0]] & ~own[edges[:, 1]]
        if not own.any() or not at_border.any():
            continue
        border = np.zeros(len(vertices), bool)
        border[edges[at_border, 0]] = True
        inner = _way_from(border, edges, lengths, own)
        tip = np.zeros(len(vertices), bool)
        tip[np.where(own, inner, -1.0).argmax()] = True
        way = _way_from(tip, edges, lengths, np.ones(len(vertices), bool))
        root = float(way[border].min())
        if root < least:
            continue
        beyond.append(way - root)
        part[own & (way < root)] = len(beyond)
        chain[own] = -len(beyond)
    chain = np.where(chain < 0, -chain, PALM)
    columns = np.stack(beyond, axis=1) if beyond else np.zeros((len(vertices), 0))
    return HandParts(part, chain.astype(np.int32), columns)


def skin_edges(faces: NDArray[np.int32]) -> NDArray[np.int64]:
    """Every edge of a closed skin, in both directions, shape [E, 2]."""
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    return np.unique(np.concatenate([directed, directed[:, ::-1]]), axis=0)


def finger_chains(
    weights: NDArray[np.float64], parents: NDArray[np.int32]
) -> list[NDArray[np.int64]]:
    """Bones of each finger: from an end of the skeleton up to where it branches.

    Bones that carry no skin, such as those at fingertips, count for nothing.
    """
    count = len(parents)
    carries = np.bincount(weights.argmax(1), minlength=count) > 0
    children: list[list[int]] = [[] for _ in range(count)]
    for bone in _ends_first(parents):
        parent = int(parents[bone])
        if (carries[bone] or children[bone]) and parent >= 0:
            children[parent].append(bone)
    several = sum(bool(carries[b] or children[b]) for b in np.flatnonzero(parents < 0)) > 1
    chains = []
    for end in np.flatnonzero(carries):
        if children[end]:
            continue
        chain = [int(end)]
        while (parent := int(parents[chain[-1]])) >= 0 and len(children[parent]) == 1:
            chain.append(parent)
        # A skeleton without branches has no fingers.
        if parent >= 0 or several:
            chains.append(np.array(chain, np.int64))
    return chains


def _ends_first(parents: NDArray[np.int32]) -> list[int]:
    """Bones in an order that has children before their parents."""
    depth = np.zeros(len(parents), np.int64)
    above = parents.astype(np.int64)
    while (above >= 0).any():
        depth += above >= 0
        above = np.where(above >= 0, parents[above], -1)
    return [int(bone) for bone in np.argsort(-depth, kind="stable")]


def _without_islands(label: NDArray[np.int32], edges: NDArray[np.int64]) -> NDArray[np.int32]:
    """Give specks of one label inside another to their neighbours."""
    label = label.copy()
    inside = label[edges[:, 0]] == label[edges[:, 1]]
    piece = skin_pieces(len(label), edges[inside])
    sizes = np.bincount(piece, minlength=len(label))
    stray = np.zeros(len(label), bool)
    for value in np.unique(label[label != PALM]):
        own = label == value
        stray |= own & (piece != piece[own][sizes[piece[own]].argmax()])
    while stray.any():
        known = stray[edges[:, 0]] & ~stray[edges[:, 1]]
        if not known.any():
            break
        votes = np.zeros((len(label), int(label.max()) + 1), np.int64)
        np.add.at(votes, (edges[known, 0], label[edges[known, 1]]), 1)
        settled = stray & votes.any(1)
        label[settled] = votes[settled].argmax(1)
        stray &= ~settled
    return label


def skin_pieces(count: int, edges: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of the connected piece that each vertex belongs to: its lowest vertex, shape [V]."""
    piece = np.arange(count)
    while True:
        before = piece.copy()
        np.minimum.at(piece, edges[:, 0], piece[edges[:, 1]])
        piece = piece[piece]
        if np.array_equal(piece, before):
            return piece


def _way_from(
    start: NDArray[np.bool_],
    edges: NDArray[np.int64],
    lengths: NDArray[np.float64],
    allowed: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Shortest way along edges between allowed vertices [m], shape [V]; infinite where none is."""
    passable = allowed[edges].all(1)
    edges, lengths = edges[passable], lengths[passable]
    way = np.where(start, 0.0, np.inf)
    while True:
        before = way.copy()
        np.minimum.at(way, edges[:, 0], way[edges[:, 1]] + lengths)
        if np.array_equal(way, before):
            return way
