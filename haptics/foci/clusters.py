# SPDX-License-Identifier: GPL-3.0-or-later
"""Weighted k-means that adapts the number of clusters to the points from frame to frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..acoustics.small_product import small_product

_SPLIT = 0.75
"""A cluster is split if its standard deviation along its longest axis exceeds this, in sigmas."""
_MERGE = 1.0
"""Clusters closer than this are merged, in sigmas."""
_SEED_DISTANCE = 1.5
"""Minimum distance between seeds, in sigmas. Too few seeds are split later; too many would remain
until they come close enough to merge."""
_SPLIT_OFFSET = 0.8
"""Offset of the two halves of a split cluster from its center, in standard deviations: the value
for points on a line."""
_WORTH = 3.0
"""A pair is merged to split another cluster only if the split gains this many times what the merge
costs. It is well above 1 so that the pair does not return in the next frame."""
_CONVERGED = 0.02
"""Centers that move less than this have converged, in sigmas."""
_SHIFTS = 4
_OFF_SKIN = 1.3
"""A mean farther than this from every skin point is in the air, in standard deviations `reach`."""
_SWEEPS_COLD, _SWEEPS_WARM = 30, 4

Real = NDArray[np.float64]


class Clusters:
    """Points with mass, to be clustered.

    All positions are relative to a nearby point, so that single precision is good to about 25 µm.

    Args:
        rows: Coordinates of the points [m], shape [3, M].
        mass: Weight of each, above 0, shape [M].
        sigma: Length scale of the clusters [m].
    """

    def __init__(self, rows: NDArray[np.float32], mass: Real, sigma: float) -> None:
        self._rows = rows
        self._square = np.einsum("im,im->m", self._rows, self._rows)
        self._mass = mass.astype(np.float32)
        self._sigma = sigma
        # Mass, first and second moments of each point; the moments of a cluster are their sums.
        self._moments = np.empty((10, len(mass)), np.float32)
        self._moments[0] = self._mass
        np.multiply(self._rows, self._mass, out=self._moments[1:4])
        np.multiply(self._rows, self._moments[1], out=self._moments[4:7])
        np.multiply(self._rows[1:], self._moments[2], out=self._moments[7:9])
        np.multiply(self._rows[2], self._moments[3], out=self._moments[9])

    def find(self, count: int, start: Real | None) -> Real:
        """Centers of at most `count` clusters [m], shape [K, 3].

        Args:
            count: Maximum number of clusters, at least 1.
            start: Centers to start from [m], shape [K, 3], whose order is kept; k-means++ seeds if
                None.
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
        """Move each center onto the skin [m], shape [K, 3].

        The result is the center of mass of the cluster around the point nearest to the center, so
        it moves smoothly with the center. If that is off the skin, for example between two fingers,
        the middle of the pressed skin near that point is used instead.

        Args:
            centers: Centers [m], shape [K, 3].
            reach: Standard deviation of the Gaussian that weights the mean [m].
        """
        score, members = self._members(centers)
        closest = (self._square - 2.0 * score).argmin(1)
        least = self._square[closest] - 2.0 * score[np.arange(len(score)), closest]
        beyond = self._square - 2.0 * score.max(0) - small_product(members.T, least)
        # The exponent is limited because processors are slow with subnormal numbers.
        members *= np.exp(np.maximum(beyond * (-0.5 / reach**2), -40.0)) * self._mass
        members[np.arange(len(members)), closest] += 1e-6 * self._mass.max()
        mean = members @ self._rows.T / members.sum(1)[:, None]
        off = (self._square - 2.0 * (mean @ self._rows)).min(1) + np.square(mean).sum(1)
        for index in np.flatnonzero(off > (_OFF_SKIN * reach) ** 2):
            mean[index] = self._mode(self._rows[:, closest[index]], reach)
        return mean.astype(np.float64)

    def _mode(self, start: NDArray[np.float32], reach: float) -> NDArray[np.float32]:
        """Mean of the skin near a local maximum of mass, found by mean shift, shape [3]."""
        place = start
        for _ in range(_SHIFTS):
            square = np.square(self._rows - place[:, None]).sum(0)
            weight = self._mass * np.exp(np.maximum(square * (-0.125 / reach**2), -40.0))
            place = (small_product(self._rows, weight) / weight.sum()).astype(np.float32)
        square = np.square(self._rows - place[:, None]).sum(0)
        weight = np.exp(np.maximum((square - square.min()) * (-0.5 / reach**2), -40.0))
        return (small_product(self._rows, weight) / weight.sum()).astype(np.float32)

    def _members(self, centers: Real) -> tuple[Real, Real]:
        """A score that is highest for the nearest center, and 1 for members, both [K, M]."""
        centers = centers.astype(np.float32)
        score = centers @ self._rows
        score -= 0.5 * np.square(centers).sum(1)[:, None]
        return score, (score >= score.max(0)).astype(np.float32)

    def _sums(self, centers: Real) -> Real:
        """Mass, first and second moments of each cluster, shape [K, 10]."""
        return small_product(self._members(centers)[1], self._moments.T).astype(np.float64)

    def _sweep(self, centers: Real, sweeps: int) -> tuple[Real, Real]:
        """Lloyd's iteration until convergence; empty clusters are removed.

        Returns:
            Centers, shape [K, 3], and the moments of their clusters, shape [K, 10].
        """
        sums = np.zeros((len(centers), 10))
        for _ in range(sweeps):
            sums = self._sums(centers)
            alive = sums[:, 0] > 0.0
            if not alive.all():
                centers, sums = centers[alive], sums[alive]
            moved = sums[:, 1:4] / sums[:, :1]
            shift = float(np.abs(moved - centers).max())
            centers = moved
            if shift < _CONVERGED * self._sigma:
                break
        return centers, sums

    def _seeds(self, count: int) -> Real:
        """k-means++: draw each seed with probability mass times squared distance to the others.

        The random numbers are the same every time.
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
            chance = self._mass * np.where(least < (_SEED_DISTANCE * self._sigma) ** 2, 0.0, least)
        return np.array(seeds, np.float64)

    def _adapted(self, centers: Real, sums: Real, count: int) -> Real | None:
        """Centers after adding, removing or moving one cluster; None if no change is needed."""
        mass = sums[:, 0]
        (keep, removed), distance, cost = self._cheapest_pair(centers, mass)
        if distance < _MERGE * self._sigma:
            result = _merged(centers, mass, keep, removed)
            return np.delete(result, removed, axis=0)
        if count == 1:
            return None
        variance, axes = np.linalg.eigh(_covariance(sums))
        largest = np.where(variance[:, 2] > (_SPLIT * self._sigma) ** 2, mass * variance[:, 2], 0.0)
        split = int(largest.argmax())
        if largest[split] == 0.0:
            return None
        step = _SPLIT_OFFSET * np.sqrt(variance[split, 2]) * axes[split, :, 2]
        if len(centers) < count:
            result = np.vstack((centers, centers[split] + step))
            result[split] -= step
            return result
        if split in (keep, removed) or _SPLIT_OFFSET**2 * largest[split] < _WORTH * cost:
            return None
        result = _merged(centers, mass, keep, removed)
        result[removed] = centers[split] + step
        result[split] -= step
        return result

    def _cheapest_pair(self, centers: Real, mass: Real) -> tuple[tuple[int, int], float, float]:
        """The two clusters that cost least to merge (Ward 1963), their distance, and the cost.

        If any clusters are close enough to be merged, only those are considered.
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


def _merged(centers: Real, mass: Real, keep: int, removed: int) -> Real:
    """A copy of the centers with one moved to the mean of two."""
    result = centers.copy()
    both = [keep, removed]
    result[keep] = np.average(centers[both], axis=0, weights=mass[both])
    return result


def _covariance(sums: Real) -> Real:
    """Covariance of clusters from their moments, shape [K, 3, 3]."""
    mean = sums[:, 1:4] / sums[:, :1]
    second = sums[:, (4, 5, 6, 5, 7, 8, 6, 8, 9)].reshape(-1, 3, 3) / sums[:, :1, None]
    return np.asarray(second - mean[:, :, None] * mean[:, None, :])
