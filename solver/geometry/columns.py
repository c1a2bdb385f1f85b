# SPDX-License-Identifier: GPL-3.0-or-later
"""Crossings of vertical lines with a closed mesh: what is inside, without a query for every point.

A line enters a body through a face that points down and leaves it through one that points up. The
running sum of signed crossings is the number of bodies around each piece of the line, which handles
overlapping bodies and cavities. An edge is tested in the same direction for both of its faces, so
that no line slips through between them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_CHUNK = 4_000_000
"""Number of pairs of line and face tested at a time."""
_NUDGE = 1e-6
"""How far lines are shifted sideways, relative to their spacing."""
_ATTEMPTS = 3
"""How many shifts are tried until every line leaves each body that it enters."""


@dataclass(frozen=True, eq=False)
class Crossings:
    """Crossings of vertical lines on a grid with a mesh, ordered by line, then from below."""

    line: NDArray[np.int64]
    """Index of the line: its x index times the number of ys, plus its y index; shape [C]."""
    height: NDArray[np.float64]
    """Height of the crossing, shape [C]."""
    winding: NDArray[np.int64]
    """Number of bodies around the line just above the crossing, shape [C]."""

    def intervals(self) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Pieces of lines inside a body: line, lower end and upper end, each of shape [I]."""
        inside = self.winding > 0
        before = np.r_[False, inside[:-1]]
        before[np.r_[True, self.line[1:] != self.line[:-1]]] = False
        enters, leaves = inside & ~before, ~inside & before
        return self.line[enters], self.height[enters], self.height[leaves]


def cross_columns(
    vertices: NDArray[np.float64],
    faces: NDArray[np.integer],
    xs: NDArray[np.float64],
    ys: NDArray[np.float64],
) -> Crossings:
    """Find where vertical lines cross a closed mesh.

    Args:
        vertices: Corner positions, shape [V, 3].
        faces: Corner indices, shape [F, 3]; bodies wound outward, cavities inward.
        xs: Positions of the lines along x, evenly spaced and ascending, shape [X].
        ys: Likewise along y, shape [Y].
    """
    nudge = _NUDGE * float(np.diff(xs[:2]).sum() or 1.0)
    for attempt in range(1, _ATTEMPTS + 1):
        # Lines through vertices or along faces, common with round sizes, would be ambiguous.
        found = _crossings(
            vertices, faces, xs + 0.7548777 * attempt * nudge, ys + 0.5698403 * attempt * nudge
        )
        line, height, sign = found
        sums = np.bincount(np.unique(line, return_inverse=True)[1].reshape(-1), weights=sign)
        if not sums.any():
            break
    else:
        wrong = np.unique(line)[sums != 0]
        kept = ~np.isin(line, wrong)
        line, height, sign = line[kept], height[kept], sign[kept]
    # The signs of a line add up to zero, so the running sum restarts with each line.
    return Crossings(line, height, np.cumsum(sign))


def _crossings(
    vertices: NDArray[np.float64],
    faces: NDArray[np.integer],
    xs: NDArray[np.float64],
    ys: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
    """Line, height and sign of each crossing, in order."""
    corners = vertices[faces]
    low, high = corners.min(1), corners.max(1)
    x0, x1 = np.searchsorted(xs, low[:, 0]), np.searchsorted(xs, high[:, 0], side="right")
    y0, y1 = np.searchsorted(ys, low[:, 1]), np.searchsorted(ys, high[:, 1], side="right")
    deep = y1 - y0
    tests = (x1 - x0) * deep
    ends = np.cumsum(tests)
    lines, heights, signs = [], [], []
    start = 0
    while start < len(faces):
        done = int(ends[start - 1]) if start else 0
        stop = max(int(np.searchsorted(ends, done + _CHUNK, side="right")), start + 1)
        part = np.arange(start, stop)[tests[start:stop] > 0]
        start = stop
        count = tests[part]
        face = np.repeat(part, count)
        within = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
        ix, iy = x0[face] + within // deep[face], y0[face] + within % deep[face]
        hit, height, sign = _cross(vertices, faces, face, xs[ix], ys[iy])
        lines.append((ix * len(ys) + iy)[hit])
        heights.append(height)
        signs.append(sign)
    line, height, sign = (np.concatenate(parts) for parts in (lines, heights, signs))
    # At equal heights, entering comes first: bodies that touch are one.
    order = np.lexsort((-sign, height, line))
    return line[order], height[order], sign[order]


def _cross(
    vertices: NDArray[np.float64],
    faces: NDArray[np.integer],
    face: NDArray[np.int64],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
) -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.int64]]:
    """Whether each line crosses its face; for those, the height, and 1 (enters) or -1 (leaves)."""
    corner = faces[face]
    sides = []
    for k in range(3):
        one, two = corner[:, k], corner[:, (k + 1) % 3]
        swap = one > two
        first, second = np.where(swap, two, one), np.where(swap, one, two)
        ax, ay = vertices[first, 0], vertices[first, 1]
        side = (vertices[second, 0] - ax) * (y - ay) - (vertices[second, 1] - ay) * (x - ax)
        # A line exactly on an edge counts as left of it, in the direction of the test.
        sides.append((side >= 0.0) ^ swap)
    left = sides[0] & sides[1] & sides[2]
    right = ~(sides[0] | sides[1] | sides[2])
    hit = left | right
    a, b, c = (vertices[corner[hit, k]] for k in range(3))
    x, y = x[hit], y[hit]
    normal = np.cross(b - a, c - a)
    steep = np.where(normal[:, 2] == 0.0, 1.0, normal[:, 2])
    height = a[:, 2] - (normal[:, 0] * (x - a[:, 0]) + normal[:, 1] * (y - a[:, 1])) / steep
    # Rounding must not carry the height of a steep face beyond the face.
    heights = np.stack([a[:, 2], b[:, 2], c[:, 2]])
    height = np.clip(height, heights.min(0), heights.max(0))
    return hit, height, np.where(left[hit], -1, 1)


def union_volume(
    vertices: NDArray[np.float64], faces: NDArray[np.integer], volume: float, step: float
) -> float:
    """Volume of the union of bodies, which may overlap.

    Exact if nothing overlaps. Otherwise lines measure the ratio of the union to the sum of volumes;
    the sampling error at flat sides affects both alike and cancels.

    Args:
        vertices: Corner positions, shape [V, 3].
        faces: Corner indices, shape [F, 3]; bodies wound outward, cavities inward.
        volume: Sum of the signed volumes.
        step: Spacing of the lines.
    """
    low, high = vertices.min(0), vertices.max(0)
    xs, ys = (np.arange(low[k] + 0.5 * step, high[k] + step, step) for k in range(2))
    crossings = cross_columns(vertices, faces, xs, ys)
    if not (crossings.winding > 1).any():
        return volume
    _, bottom, top = crossings.intervals()
    # The winding is zero between lines and outside, so only pieces inside count.
    total = float((np.diff(crossings.height) * crossings.winding[:-1]).sum())
    return volume * float((top - bottom).sum()) / total
