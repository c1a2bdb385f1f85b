# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes of the zero level of a signed distance: surface nets, smoothed along the surface.

Dual to a grid: one vertex in every cell that the surface cuts, one quad around every grid edge that
it crosses (Gibson, "Constrained Elastic Surface Nets", MICCAI 1998, 10.1007/BFb0056277). The net is
then relaxed along the surface and projected back onto it.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def _sample(
    distance: Callable[[Array], Array], low: Array, high: Array, cell: float
) -> tuple[Array, Array]:
    """Sample a signed distance on a grid, exactly only near zero; return origin and values [m]."""
    block = 4
    low = low - 0.045
    blocks = np.ceil((high + 0.045 - low) / (block * cell)).astype(int)
    where = np.indices(blocks.tolist()).reshape(3, -1).T
    center = distance(low + cell * block * (where + 0.5))
    values = np.repeat(center, block**3).reshape(-1, block, block, block)
    # A signed distance changes no faster than position; the margin is for ellipsoids, which do.
    near = np.abs(center) < 1.3 * cell * block * 0.5 * np.sqrt(3.0)
    offsets = np.indices((block,) * 3).reshape(3, -1).T
    points = low + cell * ((where[near] * block)[:, None, :] + offsets + 0.5)
    values[near] = distance(points.reshape(-1, 3)).reshape(-1, block, block, block)
    values = values.reshape(*blocks, block, block, block).transpose(0, 3, 1, 4, 2, 5)
    return low + 0.5 * cell, values.reshape(blocks * block)


_CORNERS = np.array([(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)])
"""Corners of a grid cell; corner (i, j, k) has the number 4 i + 2 j + k."""


def _connected(corners: set[int]) -> bool:
    """Whether some corners of a cell are all connected along its edges."""
    reached: set[int] = set()
    ahead = set(list(corners)[:1])
    while ahead:
        reached |= ahead
        ahead = {corner ^ bit for corner in ahead for bit in (1, 2, 4)} & corners - reached
    return reached == corners


def one_sheet() -> NDArray[np.bool_]:
    """Whether a single sheet of surface cuts each pattern of inside corners, shape [256]."""
    inside = [{corner for corner in range(8) if pattern >> corner & 1} for pattern in range(256)]
    return np.array([_connected(part) and _connected(set(range(8)) - part) for part in inside])


def _patterns(values: Array) -> NDArray[np.uint8]:
    """Number the pattern of inside corners of every cell, shape [X - 1, Y - 1, Z - 1]."""
    shape = np.array(values.shape) - 1
    pattern = np.zeros(shape, dtype=np.uint8)
    for number, (i, j, k) in enumerate(_CORNERS):
        part = values[i : shape[0] + i, j : shape[1] + j, k : shape[2] + k] < 0.0
        pattern |= part.astype(np.uint8) << np.uint8(number)
    return pattern


def _open_creases(values: Array) -> NDArray[np.uint8]:
    """Separate touching surfaces, in place, until no cell is cut by two sheets of surface.

    Each such cell loses its shallowest inside corner, so that the net closes and touching fingers
    stay apart. Returns the patterns of inside corners.
    """
    in_one_sheet = one_sheet()
    pattern = _patterns(values)
    while True:
        cells = np.argwhere(~in_one_sheet[pattern])
        if len(cells) == 0:
            return pattern
        corners = cells[:, None, :] + _CORNERS
        depth = values[tuple(corners.reshape(-1, 3).T)].reshape(-1, 8)
        shallowest = np.where(depth < 0.0, depth, -np.inf).argmax(axis=1)
        values[tuple(corners[np.arange(len(cells)), shallowest].T)] = 1e-9
        pattern = _patterns(values)


def surface_net(
    distance: Callable[[Array], Array], low: Array, high: Array, edge: float
) -> tuple[Array, NDArray[np.int32]]:
    """Mesh the zero level of a signed distance inside a box around some of its points."""
    # Each quad of the net is cut into two triangles, whose mean edge is 1.1 times the cell's.
    cell = edge / 1.1
    origin, values = _sample(distance, low, high, cell)
    pattern = _open_creases(values)
    inside = values < 0.0
    cut = (pattern > 0) & (pattern < 255)
    number = np.full(cut.shape, -1, dtype=np.int32)
    number[cut] = np.arange(np.count_nonzero(cut), dtype=np.int32)
    vertices = origin + cell * (np.argwhere(cut) + 0.5)

    quads = []
    for axis in range(3):
        _, second, third = np.roll(np.eye(3, dtype=int), -axis, axis=0)
        ahead = np.roll(inside, -1, axis=axis)
        for enters in (False, True):
            where = np.argwhere((inside != ahead) & (ahead == enters))
            around = [where - a * second - b * third for a, b in ((1, 1), (0, 1), (0, 0), (1, 0))]
            quad = np.stack([number[tuple(cells.T)] for cells in around], axis=1)
            quads.append(quad[:, ::-1] if enters else quad)
    net = np.concatenate(quads)
    vertices = _relax(vertices, net, distance, cell)
    return vertices, _triangles(vertices, net)


def _edges(net: NDArray[np.int32]) -> NDArray[np.int32]:
    return np.concatenate([net[:, [i, (i + 1) % 4]] for i in range(4)])


def _relax(
    vertices: Array, net: NDArray[np.int32], distance: Callable[[Array], Array], cell: float
) -> Array:
    """Move a net onto the surface and smooth it along the surface, shape [V, 3]."""
    edges = _edges(net)
    neighbor_count = np.bincount(edges[:, 0], minlength=len(vertices))[:, None]
    for sweep in range(9):
        if 0 < sweep < 8:
            sums = [
                np.bincount(edges[:, 0], vertices[edges[:, 1], axis], minlength=len(vertices))
                for axis in range(3)
            ]
            vertices = vertices + 0.6 * (np.stack(sums, axis=1) / neighbor_count - vertices)
        vertices = vertices + to_surface(distance, vertices, cell)
    return vertices


def to_surface(distance: Callable[[Array], Array], points: Array, max_distance: float) -> Array:
    """Offset from points to the nearby surface, limited in length [m], shape [N, 3]."""
    probe = np.array([[1, -1, -1], [-1, -1, 1], [-1, 1, -1], [1, 1, 1]]) * 2e-4
    values = distance((points[:, None, :] + probe).reshape(-1, 3)).reshape(-1, 4)
    slope = values @ probe / (4.0 * 2e-4**2)
    square = np.maximum(np.sum(slope * slope, axis=1), 0.04)
    return -slope * np.clip(values.mean(axis=1) / square, -max_distance, max_distance)[:, None]


def _triangles(vertices: Array, net: NDArray[np.int32]) -> NDArray[np.int32]:
    """Cut each quad along its shorter diagonal, shape [F, 3]."""
    first = np.linalg.norm(vertices[net[:, 0]] - vertices[net[:, 2]], axis=1)
    second = np.linalg.norm(vertices[net[:, 1]] - vertices[net[:, 3]], axis=1)
    net = np.where((first <= second)[:, None], net, np.roll(net, -1, axis=1))
    return np.concatenate([net[:, [0, 1, 2]], net[:, [0, 2, 3]]]).astype(np.int32)
