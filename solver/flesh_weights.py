# SPDX-License-Identifier: GPL-3.0-or-later
"""How much each bone carries each node of the flesh, so that the flesh follows the skin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .hand_rig import MOST_BONES

SMOOTHNESS = 0.03
"""Weight of differences along edges of tetrahedra, over that of differences from the skin."""

_ROUNDS = 200
_RESIDUAL = 1e-4


def flesh_weights(
    corners: NDArray[np.int32],
    node_count: int,
    carrier: NDArray[np.int32],
    share: NDArray[np.float64],
    wanted: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Fit weights of nodes to those of the skin: least squares, smooth where there is no skin.

    Args:
        corners: Tetrahedra, shape [T, 4].
        node_count: Number N of nodes.
        carrier: Tetrahedron of each of S points of the skin, shape [S].
        share: Their barycentric coordinates in it, shape [S, 4].
        wanted: How much each bone carries them, shape [S, B].

    Returns:
        Weights of at most four bones a node, rows adding up to one, shape [N, B].
    """
    ring = corners[carrier]
    matrix = _NormalMatrix(corners, node_count, ring, share)
    target = np.zeros((node_count, wanted.shape[1]))
    for corner in range(4):
        np.add.at(target, ring[:, corner], share[:, corner, None] * wanted)
    weights = _conjugate_gradients(matrix, target)
    weights = np.maximum(weights, 0.0)
    least = -np.sort(-weights, axis=1)[:, MOST_BONES - 1 : MOST_BONES]
    weights = np.where(weights >= np.maximum(least, 0.01), weights, 0.0)
    return weights / weights.sum(1, keepdims=True)


class _NormalMatrix:
    """The fit's symmetric matrix, which couples nodes of the same tetrahedron only."""

    def __init__(
        self,
        corners: NDArray[np.int32],
        node_count: int,
        ring: NDArray[np.int32],
        share: NDArray[np.float64],
    ) -> None:
        pairs = [(i, j) for i in range(4) for j in range(4) if i != j]
        edges = np.concatenate([corners[:, pair] for pair in pairs]).astype(np.int64)
        keys = edges[:, 0] * node_count + edges[:, 1]
        unique = np.unique(keys)
        data = np.concatenate([ring[:, pair] for pair in pairs]).astype(np.int64)
        value = np.concatenate([share[:, i] * share[:, j] for i, j in pairs])
        where = np.searchsorted(unique, data[:, 0] * node_count + data[:, 1])
        per_node = len(ring) / node_count
        # Few points of skin must weigh as much against the smoothness as many do.
        smooth = SMOOTHNESS * per_node
        self.column = unique % node_count
        self.start = np.searchsorted(unique, np.arange(node_count) * node_count)
        self.value = np.bincount(where, weights=value, minlength=len(unique)) - smooth
        degree = np.bincount(unique // node_count, minlength=node_count)
        self.diagonal = (smooth + 1e-9) * degree + sum(
            np.bincount(ring[:, i], weights=share[:, i] ** 2, minlength=node_count)
            for i in range(4)
        )

    def __matmul__(self, vector: NDArray[np.float64]) -> NDArray[np.float64]:
        along = np.add.reduceat(self.value[:, None] * vector[self.column], self.start, axis=0)
        return self.diagonal[:, None] * vector + along


def _conjugate_gradients(
    matrix: _NormalMatrix, target: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Solve for all columns at once, preconditioned by the diagonal."""
    scale = 1.0 / matrix.diagonal[:, None]
    solution = np.zeros_like(target)
    residual = target.copy()
    direction = scale * residual
    product = np.einsum("ij,ij->j", residual, direction)
    first = np.maximum(product, 1e-30)
    for _ in range(_ROUNDS):
        if (product <= _RESIDUAL**2 * first).all():
            break
        image = matrix @ direction
        step = product / np.maximum(np.einsum("ij,ij->j", direction, image), 1e-300)
        solution += step * direction
        residual -= step * image
        ahead = scale * residual
        before, product = product, np.einsum("ij,ij->j", residual, ahead)
        direction = ahead + product / np.maximum(before, 1e-300) * direction
    return solution
