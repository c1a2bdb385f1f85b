# SPDX-License-Identifier: GPL-3.0-or-later
"""Stops spread evenly over touched skin, and a short closed way through all of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_MOST_STOPS = 96

Real = NDArray[np.float64]


def spread_stops(points: Real, reach: float, *, first: int, kept: Real | None = None) -> Real:
    """Choose stops so that every point lies within `reach` of one [m], shape [N, 3].

    Each next stop is the point that is farthest from those there are (Gonzalez 1985), then stops
    move to the middle of what they serve, and onto the nearest point again.

    Args:
        points: Touched skin [m], shape [M, 3].
        reach: How far a stop serves [m].
        first: Index of the point to start from.
        kept: Stops of the frame before that are kept where they still lie on these points [m],
            shape [L, 3].
    """
    stops: list[Real] = []
    least = np.full(len(points), np.inf)
    for stop in () if kept is None else kept:
        away = np.square(points - stop).sum(1)
        nearest = int(away.argmin())
        # A kept stop may have slid along with the skin, but not onto another stop's part.
        if away[nearest] < (0.5 * reach) ** 2 and least[nearest] > (0.8 * reach) ** 2:
            stops.append(points[nearest])
            np.minimum(least, np.square(points - points[nearest]).sum(1), out=least)
    pick = int(least.argmax()) if stops else first
    while len(stops) < _MOST_STOPS and (not stops or least[pick] > reach * reach):
        stops.append(points[pick])
        np.minimum(least, np.square(points - points[pick]).sum(1), out=least)
        pick = int(least.argmax())
    result = np.array(stops)
    rows = points.T
    for _ in range(2):
        score = result @ rows - 0.5 * np.square(result).sum(1)[:, None]
        own = score.argmax(0)
        size = np.maximum(np.bincount(own, minlength=len(result)), 1)
        middle = np.stack([np.bincount(own, row, len(result)) for row in rows], axis=1)
        middle = np.where((size > 1)[:, None], middle / size[:, None], result)
        square = np.square(points).sum(1) - 2.0 * middle @ rows
        result = points[square.argmin(1)]
    return np.unique(result, axis=0) if kept is None else result[_first_of_each(result)]


def _first_of_each(stops: Real) -> NDArray[np.intp]:
    """Indices of the stops less repetitions, in their order."""
    return np.sort(np.unique(stops, axis=0, return_index=True)[1])


def closed_tour(stops: Real) -> NDArray[np.intp]:
    """Order of stops on a short closed way: nearest neighbour, then 2-opt and or-opt, shape [N].

    For 50 stops it is within some 5 % of the shortest.
    """
    count = len(stops)
    if count < 4:
        return np.arange(count)
    apart = np.linalg.norm(stops[:, None] - stops[None], axis=2)
    order = [0]
    left = np.ones(count, bool)
    left[0] = False
    while len(order) < count:
        order.append(int(np.where(left, apart[order[-1]], np.inf).argmin()))
        left[order[-1]] = False
    tour = np.array(order)
    for _ in range(4 * count):
        better = _uncrossed(tour, apart)
        if better is None:
            better = _moved(tour, apart)
        if better is None:
            break
        tour = better
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
