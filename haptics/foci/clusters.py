# SPDX-License-Identifier: GPL-3.0-or-later
"""Weighted k-means that keeps as many clusters as points need, frame after frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..acoustics.small_product import small_product

_SPLIT = 0.75
"""A cluster is split while its spread along its longest axis is more, over sigma."""
_MERGE = 1.0
"""Clusters nearer than this are one, over sigma."""
_APART = 1.5
"""Seeds are no nearer than this, over sigma: what they lack is split later, what they have too much
would stay until it came near enough to merge."""
_PART = 0.8
"""Halves of a split cluster are put so far from its middle, over its spread: those of a line."""
_WORTH = 3.0
"""A pair is merged to free a cluster for a split elsewhere that gains so many times what it costs:
well above 1, lest the pair comes back with the next frame."""
_STILL = 0.02
"""Centers that move less are where they should be, over sigma."""
_SHIFTS = 4
_OFF_SKIN = 1.3
"""A mean of skin farther from every point than this, over its reach, lies in the air."""
_SWEEPS_COLD, _SWEEPS_WARM = 30, 4

Real = NDArray[np.float64]


class Clusters:
    """Points with mass, and the search for centers among them.

    All positions are relative to a point nearby, so that single precision is exact to some 25 µm.

    Args:
        rows: Coordinates of the points [m], shape [3, M].
        mass: Weight of each, above 0, shape [M].
        sigma: Length that clusters are told apart by [m].
    """

    def __init__(self, rows: NDArray[np.float32], mass: Real, sigma: float) -> None:
        self._rows = rows
        self._square = np.einsum("im,im->m", self._rows, self._rows)
        self._mass = mass.astype(np.float32)
        self._sigma = sigma
        # Mass, first and second moments of every point: a cluster's are their sums.
        self._moments = np.empty((10, len(mass)), np.float32)
        self._moments[0] = self._mass
        np.multiply(self._rows, self._mass, out=self._moments[1:4])
        np.multiply(self._rows, self._moments[1], out=self._moments[4:7])
        np.multiply(self._rows[1:], self._moments[2], out=self._moments[7:9])
        np.multiply(self._rows[2], self._moments[3], out=self._moments[9])

    def find(self, count: int, start: Real | None) -> Real:
        """Centers of at most `count` clusters [m], shape [K, 3].

        Args:
            count: Most clusters, at least 1.
            start: Centers to go on from [m], shape [K, 3]; k-means++ seeds where not given. Their
                order is kept.
        """
        if start is None:
            centers, sums = self._sweep(self._seeds(count), _SWEEPS_COLD)
        else:
            centers, sums = self._sweep(start, _SWEEPS_WARM)
        for _ in range(2 * count):
            changed = self._adapted(centers, sums, count)
            if changed is None:
                break
            centers, sums = self._sweep(changed, _SWEEPS_WARM)
        return centers

    def snapped(self, centers: Real, reach: float) -> Real:
        """The skin beside each center [m], shape [K, 3].

        It is the mean mass of the cluster about the point nearest to the center, which moves
        smoothly with the center. Where that lies off the skin, as between two fingers, it is the
        middle of the pressed skin next to the nearest point.

        Args:
            centers: Centers [m], shape [K, 3].
            reach: Standard deviation of the mean [m].
        """
        score, members = self._members(centers)
        closest = (self._square - 2.0 * score).argmin(1)
        least = self._square[closest] - 2.0 * score[np.arange(len(score)), closest]
        beyond = self._square - 2.0 * score.max(0) - small_product(members.T, least)
        # Nothing is smaller than e^-40: processors are slow with such numbers.
        members *= np.exp(np.maximum(beyond * (-0.5 / reach**2), -40.0)) * self._mass
        members[np.arange(len(members)), closest] += 1e-6 * self._mass.max()
        mean = members @ self._rows.T / members.sum(1)[:, None]
        off = (self._square - 2.0 * (mean @ self._rows)).min(1) + np.square(mean).sum(1)
        for index in np.flatnonzero(off > (_OFF_SKIN * reach) ** 2):
            mean[index] = self._beside(self._rows[:, closest[index]], reach)
        return mean.astype(np.float64)

    def _beside(self, start: NDArray[np.float32], reach: float) -> NDArray[np.float32]:
        """The skin beside where mean shift ends that begins at a point, shape [3]."""
        place = start
        for _ in range(_SHIFTS):
            square = np.square(self._rows - place[:, None]).sum(0)
            weight = self._mass * np.exp(np.maximum(square * (-0.125 / reach**2), -40.0))
            place = (small_product(self._rows, weight) / weight.sum()).astype(np.float32)
        square = np.square(self._rows - place[:, None]).sum(0)
        weight = np.exp(np.maximum((square - square.min()) * (-0.5 / reach**2), -40.0))
        return (small_product(self._rows, weight) / weight.sum()).astype(np.float32)

    def _members(self, centers: Real) -> tuple[Real, Real]:
        """What is greatest for the nearest center, and 1 where that is this one, shape [K, M]."""
        centers = centers.astype(np.float32)
        score = centers @ self._rows
        score -= 0.5 * np.square(centers).sum(1)[:, None]
        return score, (score >= score.max(0)).astype(np.float32)

    def _sums(self, centers: Real) -> Real:
        """Mass, first and second moments of each center's cluster, shape [K, 10]."""
        return small_product(self._members(centers)[1], self._moments.T).astype(np.float64)

    def _sweep(self, centers: Real, most: int) -> tuple[Real, Real]:
        """Lloyd's iteration; clusters that nothing belongs to vanish.

        Returns:
            Centers, shape [K, 3], and the moments they come from, shape [K, 10].
        """
        sums = np.zeros((len(centers), 10))
        for _ in range(most):
            sums = self._sums(centers)
            alive = sums[:, 0] > 0.0
            if not alive.all():
                centers, sums = centers[alive], sums[alive]
            moved = sums[:, 1:4] / sums[:, :1]
            shift = float(np.abs(moved - centers).max())
            centers = moved
            if shift < _STILL * self._sigma:
                break
        return centers, sums

    def _seeds(self, count: int) -> Real:
        """k-means++: each next seed is drawn by mass times squared distance to those there are.

        The drawing is the same each time.
        """
        random = np.random.default_rng(20210706)
        chance = self._mass
        least = np.full(len(chance), np.inf)
        seeds: list[NDArray[np.float32]] = []
        while len(seeds) < count and chance.any():
            sums = np.cumsum(chance)
            pick = int(np.searchsorted(sums, random.random() * sums[-1], side="right"))
            seed = self._rows[:, min(pick, len(chance) - 1)]
            seeds.append(seed)
            np.minimum(least, np.square(self._rows - seed[:, None]).sum(0), out=least)
            chance = self._mass * np.where(least < (_APART * self._sigma) ** 2, 0.0, least)
        return np.array(seeds, np.float64)

    def _adapted(self, centers: Real, sums: Real, count: int) -> Real | None:
        """Centers with one cluster more, fewer or elsewhere; None where nothing is to change."""
        mass = sums[:, 0]
        (keep, gone), apart, cost = self._cheapest_pair(centers, mass)
        if apart < _MERGE * self._sigma:
            result = _merged(centers, mass, keep, gone)
            return np.delete(result, gone, axis=0)
        if count == 1:
            return None
        variance, axes = np.linalg.eigh(_covariance(sums))
        largest = np.where(variance[:, 2] > (_SPLIT * self._sigma) ** 2, mass * variance[:, 2], 0.0)
        which = int(largest.argmax())
        if largest[which] == 0.0:
            return None
        step = _PART * np.sqrt(variance[which, 2]) * axes[which, :, 2]
        if len(centers) < count:
            result = np.vstack((centers, centers[which] + step))
            result[which] -= step
            return result
        if which in (keep, gone) or _PART * _PART * largest[which] < _WORTH * cost:
            return None
        result = _merged(centers, mass, keep, gone)
        result[gone] = centers[which] + step
        result[which] -= step
        return result

    def _cheapest_pair(self, centers: Real, mass: Real) -> tuple[tuple[int, int], float, float]:
        """The two clusters that cost least to merge (Ward 1963): who, how far apart, the cost.

        Where clusters are nearer than the distance of merging, it is those among them.
        """
        if len(centers) < 2:
            return (0, 0), np.inf, np.inf
        square = np.square(centers[:, None] - centers[None]).sum(2)
        np.fill_diagonal(square, np.inf)
        cost = square * (np.outer(mass, mass) / np.add.outer(mass, mass))
        close = square < (_MERGE * self._sigma) ** 2
        ranked = np.where(close, cost, np.inf) if close.any() else cost
        first, second = sorted(divmod(int(ranked.argmin()), len(centers)))
        return (first, second), float(np.sqrt(square[first, second])), float(cost[first, second])


def _merged(centers: Real, mass: Real, keep: int, gone: int) -> Real:
    """A copy of the centers where one stands for two."""
    result = centers.copy()
    both = (keep, gone)
    result[keep] = np.average(centers[both, :], axis=0, weights=mass[[keep, gone]])
    return result


def _covariance(sums: Real) -> Real:
    """Covariance of clusters from their moments, shape [K, 3, 3]."""
    mean = sums[:, 1:4] / sums[:, :1]
    second = sums[:, (4, 5, 6, 5, 7, 8, 6, 8, 9)].reshape(-1, 3, 3) / sums[:, :1, None]
    return np.asarray(second - mean[:, :, None] * mean[:, None, :])
