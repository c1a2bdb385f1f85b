# SPDX-License-Identifier: GPL-3.0-or-later
"""Stops spread evenly over touched skin, and a short closed way through all of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_MAX_STOPS = 96

Real = NDArray[np.float64]


def spread_stops(
    points: Real, reach: float, *, first: int, kept: Real | None = None
) -> tuple[Real, int]:
    """Choose stops so that every point lies within about `reach` of one.

    Each next stop is the point that is farthest from those there are (Gonzalez 1985), then stops
    move to the middle of what they serve, and onto the nearest point again.

    Args:
        points: Touched skin [m], shape [M, 3].
        reach: How far a stop serves [m].
        first: Index of the point to start from.
        kept: Stops of the frame before that are kept where they still lie on these points [m],
            shape [L, 3].

    Returns:
        Stops [m], shape [N, 3], and how many of them, the first, were kept in their order.
    """
    middle = points.mean(0)
    rows = np.ascontiguousarray((points - middle).T, np.float32)
    size = np.square(rows).sum(0)

    def squares(places: NDArray[np.float32]) -> NDArray[np.float32]:
        """Squares of the distances of places to all points [m²], shape [N, M]."""
        square = places @ rows
        square *= -2.0
        square += size
        square += np.square(places).sum(1)[:, None]
        return square

    chosen: list[int] = []
    least = np.full(len(points), np.inf, np.float32)
    if kept is not None and len(kept):
        away = squares((kept - middle).astype(np.float32))
        for nearest, square in zip(away.argmin(1), away, strict=True):
            # A kept stop may have slid along with the skin, but not onto another stop's part.
            if square[nearest] < (0.5 * reach) ** 2 and least[nearest] > (0.8 * reach) ** 2:
                chosen.append(int(nearest))
                np.minimum(least, square, out=least)
    known = len(chosen)
    while len(chosen) < _MAX_STOPS and (not chosen or float(least.max()) > reach * reach):
        chosen.append(int(least.argmax()) if chosen else first)
        np.minimum(least, squares(rows[:, chosen[-1:]].T)[0], out=least)
    index = np.array(chosen)
    for _ in range(2):
        own = squares(rows[:, index].T).argmin(0)
        served = np.bincount(own, minlength=len(index))
        means = np.stack([np.bincount(own, row, len(index)) for row in rows], axis=1)
        means = (means / np.maximum(served, 1)[:, None]).astype(np.float32)
        index = np.where(served > 0, squares(means).argmin(1), index)
    places = np.sort(np.unique(index, return_index=True)[1])
    return points[index[places]], int(np.count_nonzero(places < known))


def closed_tour(stops: Real, known: int = 0) -> NDArray[np.intp]:
    """Order of stops on a short closed way: a first one, then 2-opt and or-opt, shape [N].

    For 50 stops it is within some 5 % of the shortest.

    Args:
        stops: Places [m], shape [N, 3].
        known: How many of them, the first, stand in the order of a tour already; the others are
            put in where they lengthen it least. Else it goes to the nearest next.
    """
    count = len(stops)
    if count < 4:
        return np.arange(count)
    apart = np.linalg.norm(stops[:, None] - stops[None], axis=2)
    tour = _inserted(known, apart) if known > 2 else _nearest_next(apart)
    for _ in range(4 * count):
        better = _uncrossed(tour, apart)
        if better is None:
            better = _moved(tour, apart)
        if better is None:
            break
        tour = better
    return tour


def _nearest_next(apart: Real) -> NDArray[np.intp]:
    """A tour that always goes on to the nearest stop left."""
    order = [0]
    left = np.ones(len(apart), bool)
    left[0] = False
    while len(order) < len(apart):
        order.append(int(np.where(left, apart[order[-1]], np.inf).argmin()))
        left[order[-1]] = False
    return np.array(order)


def _inserted(known: int, apart: Real) -> NDArray[np.intp]:
    """A known tour with each further stop put in where it lengthens it least."""
    tour = np.arange(known)
    for stop in range(known, len(apart)):
        after = np.roll(tour, -1)
        longer = apart[tour, stop] + apart[stop, after] - apart[tour, after]
        tour = np.insert(tour, int(longer.argmin()) + 1, stop)
    return tour


def _uncrossed(tour: NDArray[np.intp], apart: Real) -> NDArray[np.intp] | None:
    """The tour with the part turned round that shortens it most (2-opt), None where none does."""
    after = np.roll(tour, -1)
    link = apart[tour, after]
    change = apart[np.ix_(tour, tour)] + apart[np.ix_(after, after)] - np.add.outer(link, link)
    change[np.tril_indices(len(tour))] = 0.0
    first, second = divmod(int(change.argmin()), len(tour))
    if change[first, second] > -1e-9:
        return None
    result = tour.copy()
    result[first + 1 : second + 1] = tour[first + 1 : second + 1][::-1]
    return result


def _moved(tour: NDArray[np.intp], apart: Real) -> NDArray[np.intp] | None:
    """The tour with the stop put elsewhere that shortens it most (or-opt), None where none does."""
    before, after = np.roll(tour, 1), np.roll(tour, -1)
    gain = apart[before, tour] + apart[tour, after] - apart[before, after]
    cost = apart[np.ix_(tour, tour)] + apart[np.ix_(tour, after)] - apart[tour, after]
    change = cost - gain[:, None]
    rows = np.arange(len(tour))
    change[rows, rows] = change[rows, rows - 1] = 0.0
    which, where = divmod(int(change.argmin()), len(tour))
    if change[which, where] > -1e-9:
        return None
    stop = tour[which]
    rest = np.delete(tour, which)
    place = int(np.flatnonzero(rest == tour[where])[0])
    return np.insert(rest, place + 1, stop)
