# SPDX-License-Identifier: GPL-3.0-or-later
"""Sparsity pattern of the stiffness matrix of a tetrahedral mesh."""

import numpy as np
from numpy.typing import NDArray


def block_pattern(
    tetrahedra: NDArray[np.int32], node_count: int
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Blocks of the stiffness matrix, one for each pair of nodes that share a tetrahedron, by rows.

    Returns:
        Index of each row's first block, shape [N + 1]; the column of each block, diagonal blocks
        first; index of each block's first part; and the tetrahedron and two corners of each part.
    """
    count = len(tetrahedra)
    first, second = (corner.ravel() for corner in np.indices((4, 4)))
    off = first != second
    first, second = first[off], second[off]
    rows, columns = tetrahedra[:, first].ravel(), tetrahedra[:, second].ravel()
    parts = np.column_stack(
        [np.repeat(np.arange(count), len(first)), np.tile(first, count), np.tile(second, count)]
    )
    own = np.arange(node_count)
    key = np.concatenate([rows.astype(np.int64) * (node_count + 1) + columns + 1])
    order = np.argsort(key, kind="stable")
    keys, sizes = np.unique(key, return_counts=True)
    # The diagonal block comes first; it is computed from the others, so it has no parts.
    keys = np.concatenate([own.astype(np.int64) * (node_count + 1), keys])
    sizes = np.concatenate([np.zeros(node_count, int), sizes])
    by_key = np.argsort(keys, kind="stable")
    keys, sizes = keys[by_key], sizes[by_key]
    block_row = keys // (node_count + 1)
    column = keys % (node_count + 1) - 1
    column = np.where(column < 0, block_row, column)
    row = np.searchsorted(block_row, np.arange(node_count + 1))
    share = np.concatenate([[0], np.cumsum(sizes)])
    return (
        row.astype(np.int32),
        column.astype(np.int32),
        share.astype(np.int32),
        parts[order].astype(np.int32),
    )


def sum_by_block(
    matrices: NDArray[np.float64],
    tetrahedra: NDArray[np.int32],
    row: NDArray[np.int32],
    column: NDArray[np.int32],
    share: NDArray[np.int32],
    part: NDArray[np.int32],
) -> NDArray[np.float64]:
    """Sum matrices of tetrahedra, shape [T, 4, 4], to one value for each block of the pattern."""
    values = np.zeros(len(column))
    at = np.repeat(np.arange(len(column)), np.diff(share))
    np.add.at(values, at, matrices[part[:, 0], part[:, 1], part[:, 2]])
    own = np.einsum("tkk->tk", matrices)
    np.add.at(values, row[tetrahedra.ravel()], own.ravel())
    return values


def incidences(tetrahedra: NDArray[np.int32], node_count: int) -> NDArray[np.int32]:
    """Tetrahedra around each node and its corner in them, shape [N, K, 2], padded with -1."""
    nodes = tetrahedra.ravel()
    order = np.argsort(nodes, kind="stable")
    counts = np.bincount(nodes, minlength=node_count)
    begin = np.concatenate([[0], np.cumsum(counts)[:-1]])
    column = np.arange(len(nodes)) - begin[nodes[order]]
    table = np.full((node_count, int(counts.max(initial=1)), 2), -1, np.int32)
    table[nodes[order], column, 0] = order // 4
    table[nodes[order], column, 1] = order % 4
    return table
