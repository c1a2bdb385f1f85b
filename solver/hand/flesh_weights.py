# SPDX-License-Identifier: GPL-3.0-or-later
"""Fits bone weights of the flesh's nodes, so that the flesh follows the skin.

A joint o that rotates by R moves a point x of the skin by (R − I) u (x − o), where u is the total
weight of all bones beyond the joint. A point in a tetrahedron with barycentric coordinates s, nodes
X and total weights U moves by (R − I) Σ s U (X − o). For each joint, U minimizes the squared
difference of the two, independently of R. A bone's weight is its U minus those of its children.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry.lattice_tetrahedra import Tetrahedra
from .rig import MAX_BONES

SMOOTHNESS = 0.01
"""Weight of differences along tetrahedron edges, relative to differences from the skin."""
NEGLIGIBLE = 0.01
"""Weights below this are dropped."""

_ROUNDS = 100
_RESIDUAL = 1e-3
_PAIRS = [(i, j) for i in range(4) for j in range(4) if i != j]


def flesh_weights(
    flesh: Tetrahedra,
    carrier: NDArray[np.int32],
    share: NDArray[np.float64],
    points: NDArray[np.float64],
    skin_weights: NDArray[np.float64],
    joints: NDArray[np.float64],
    parents: NDArray[np.int32],
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Fit the bone weights of nodes to those of the skin.

    Args:
        flesh: Tetrahedra with N nodes.
        carrier: Tetrahedron of each of S points of the skin, shape [S].
        share: Their barycentric coordinates in it, shape [S, 4].
        points: Positions of the points [m], shape [S, 3].
        skin_weights: Bone weights of the points, rows summing to one, shape [S, B].
        joints: The point about which each bone rotates [m], shape [B, 3].
        parents: Index of each bone's parent, -1 for a root, shape [B]; parents before children.

    Returns:
        Bones of each node, shape [N, 4], and their weights, rows summing to one, shape [N, 4].
    """
    couplings = _Couplings(flesh, flesh.corners[carrier], share)
    bone_count, node_count = skin_weights.shape[1], len(flesh.points)
    beyond = skin_weights.copy()
    for bone in range(bone_count - 1, -1, -1):
        if parents[bone] >= 0:
            beyond[:, parents[bone]] += beyond[:, bone]
    fitted = np.zeros((node_count, bone_count))
    for bone in range(bone_count):
        own = beyond[:, bone]
        if own.max() < 1e-9:
            continue
        if own.min() > 1.0 - 1e-9:
            fitted[:, bone] = 1.0
        else:
            fitted[:, bone] = couplings.fit(joints[bone], points, own)
        if parents[bone] >= 0:
            fitted[:, bone] = np.minimum(fitted[:, bone], fitted[:, parents[bone]])
    weights = fitted.copy()
    for bone in range(bone_count):
        if parents[bone] >= 0:
            weights[:, parents[bone]] -= fitted[:, bone]
    return _strongest(weights)


class _Couplings:
    """The sparse least-squares system: nodes are coupled if they share a tetrahedron."""

    def __init__(
        self, flesh: Tetrahedra, ring: NDArray[np.int32], share: NDArray[np.float64]
    ) -> None:
        self.nodes = flesh.points
        self.ring = ring
        self.share = share
        count = len(flesh.points)
        edges = np.concatenate([flesh.corners[:, pair] for pair in _PAIRS]).astype(np.int64)
        keys = np.unique(edges[:, 0] * count + edges[:, 1])
        self.row, self.column = keys // count, keys % count
        self.start = np.searchsorted(keys, np.arange(count) * count)
        data = np.concatenate([ring[:, pair] for pair in _PAIRS]).astype(np.int64)
        self.entry = np.searchsorted(keys, data[:, 0] * count + data[:, 1])
        # Scaled so that smoothness does not depend on the number of skin points.
        self.smoothness = SMOOTHNESS * len(ring) / count

    def fit(
        self, joint: NDArray[np.float64], points: NDArray[np.float64], own: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Total weight of the bones beyond a joint for each node, 0 to 1, shape [N]."""
        arm = self.nodes - joint
        arms = self.share[..., None] * arm[self.ring]
        value = np.concatenate([np.einsum("gi,gi->g", arms[:, i], arms[:, j]) for i, j in _PAIRS])
        length = np.linalg.norm(arm, axis=1)
        smooth = self.smoothness * length[self.row] * length[self.column]
        off = np.bincount(self.entry, weights=value, minlength=len(smooth)) - smooth
        diagonal = np.add.reduceat(smooth, self.start) + 1e-12
        goal = own[:, None] * (points - joint)
        target = np.zeros(len(arm))
        for i in range(4):
            square = np.einsum("gi,gi->g", arms[:, i], arms[:, i])
            diagonal += np.bincount(self.ring[:, i], weights=square, minlength=len(arm))
            image = np.einsum("gi,gi->g", arms[:, i], goal)
            target += np.bincount(self.ring[:, i], weights=image, minlength=len(arm))
        return np.clip(self._solved(off, diagonal, target), 0.0, 1.0)

    def _solved(
        self,
        off: NDArray[np.float64],
        diagonal: NDArray[np.float64],
        target: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Conjugate gradients, preconditioned by the diagonal, shape [N]."""
        solution = np.zeros(len(target))
        residual = target.copy()
        direction = residual / diagonal
        product = first = float(residual @ direction)
        for _ in range(_ROUNDS):
            if product <= _RESIDUAL**2 * first:
                break
            image = diagonal * direction
            image += np.add.reduceat(off * direction[self.column], self.start)
            step = product / float(direction @ image)
            solution += step * direction
            residual -= step * image
            scaled = residual / diagonal
            previous, product = product, float(residual @ scaled)
            direction = scaled + product / previous * direction
        return solution


def _strongest(
    weights: NDArray[np.float64],
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """The four strongest bones of each node, and their weights."""
    padding = max(0, MAX_BONES - weights.shape[1])
    weights = np.pad(np.maximum(weights, 0.0), ((0, 0), (0, padding)))
    bones = np.argsort(-weights, axis=1, kind="stable")[:, :MAX_BONES]
    chosen = np.take_along_axis(weights, bones, axis=1)
    chosen = np.where(chosen >= NEGLIGIBLE, chosen, 0.0)
    bones = np.where(chosen > 0.0, bones, bones[:, :1])
    return bones.astype(np.int32), chosen / chosen.sum(1, keepdims=True)
