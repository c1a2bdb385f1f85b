# SPDX-License-Identifier: GPL-3.0-or-later
"""Where an array should press, and how hard: focal points clustered from a pressure field.

After section IV-B of Barreiro, Torres and Otaduy, *Natural Tactile Interaction with Virtual Clay*,
WHC 2021, whose clustering is that of Barreiro, Sinclair and Otaduy, "Ultrasound rendering of
tactile interaction with fluids", WHC 2019 (10.1109/WHC.2019.8816137). Seeds are those of Arthur and
Vassilvitskii, "k-means++", SODA 2007.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .clusters import Clusters

PRESSURE_RULES = ("least_squares", "printed")
"""How a focus gets its pressure: the true minimizer of equation 9, or what the paper prints."""

_SNAP = 0.3
"""Reach of the mean of the skin beside a center that stands for the skin there, over sigma."""

Real = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Foci:
    """Focal points of one moment. Their order is kept from frame to frame while they live."""

    positions: Real
    """On the skin [m], shape [K, 3]."""
    pressures: Real
    """Focal pressure of each [Pa], shape [K]."""
    assignment: NDArray[np.intp]
    """Index of the nearest focus for each point of the field, shape [G]; -1 without foci."""
    sigma: float
    """Standard deviation of the Gaussian that a focus is taken for [m]."""

    @property
    def count(self) -> int:
        """Number of foci."""
        return len(self.pressures)


def focus(
    positions: ArrayLike,
    pressures: ArrayLike,
    weights: ArrayLike,
    *,
    count: int = 8,
    sigma: float,
    previous: Foci | None = None,
    rule: str = "least_squares",
    ceiling: float | None = None,
) -> Foci:
    """Choose focal points that stand for a pressure field.

    Their places are a weighted k-means clustering of α p* (equation 8), seeded by k-means++ or,
    from frame to frame, by the last foci; then each is laid onto the skin beside it. There are as
    many as the touched skin needs: a cluster is split while its spread along its longest axis is
    more than 0.75 sigma, and foci nearer than one sigma, which no array of that wavelength can tell
    apart, become one. Their pressures fit p* over each focus's Voronoi region (equation 9): the
    least-squares solution is Σ p* G / Σ G², G being the Gaussian; the paper prints Σ p* G / Σ G,
    which gives too little (``rule="printed"``). α is not in equation 9: with it, finger pads would
    be rendered better by less than a hundredth.

    Args:
        positions: Points of the skin [m], shape [G, 3].
        pressures: Target pressure p* at each [Pa], shape [G].
        weights: Perceptual weight α of each, shape [G].
        count: Foci that the array can do at once.
        sigma: Standard deviation of a focus, the wavelength [m].
        previous: Foci of the frame before, to go on from.
        rule: One of `PRESSURE_RULES`.
        ceiling: Greatest pressure of a focus [Pa]; none where not given.

    Returns:
        At most `count` foci; none where nothing is touched.

    Raises:
        ValueError: Shapes do not fit, values are not finite or below 0, or an option is none of
            those there are.
    """
    points = np.asarray(positions, np.float64)
    target = np.asarray(pressures, np.float64)
    alpha = np.asarray(weights, np.float64)
    if target.ndim != 1 or points.shape != (len(target), 3) or alpha.shape != target.shape:
        raise ValueError(
            f"A field has positions of shape {points.shape}, pressures of {target.shape} and "
            f"weights of {alpha.shape}; expected (G, 3), (G,) and (G,)."
        )
    mass = alpha * target
    if rule not in PRESSURE_RULES:
        raise ValueError(f"rule is {rule!r}; it must be one of {', '.join(PRESSURE_RULES)}.")
    if count < 0 or not (math.isfinite(sigma) and sigma > 0):
        raise ValueError(f"count is {count}, sigma {sigma!r}; they must be at least 0 and above 0.")
    # One sum instead of three tests of every value: it is finite only if all are.
    if not math.isfinite(float(points.sum()) + float(mass.sum()) + float(target.sum())):
        raise ValueError("Positions, pressures and weights of a field must be finite.")
    if mass.min(initial=0.0) < 0.0 or target.min(initial=0.0) < 0.0:
        raise ValueError("Pressures and weights of a field must be at least 0.")
    touched = np.flatnonzero(mass)
    if count == 0 or len(touched) == 0:
        nobody = np.full(len(target), -1, np.intp)
        return Foci(np.zeros((0, 3)), np.zeros(0), nobody, sigma)
    origin = points[touched[0]]
    rows = _rows(points, origin)
    all_touched = len(touched) == len(points)
    clusters = Clusters(
        rows if all_touched else rows[:, touched], mass if all_touched else mass[touched], sigma
    )
    start = None
    if previous is not None and previous.count > 0:
        start = previous.positions[:count] - origin
    centers = clusters.find(count, start)
    places = clusters.snapped(centers, _SNAP * sigma)
    assignment, square = _nearest(rows, places)
    fall = np.exp(square * (-0.5 / sigma**2))
    above = np.bincount(assignment, target * fall, len(places))
    below = np.bincount(assignment, fall if rule == "printed" else fall * fall, len(places))
    found = above / np.maximum(below, 1e-300)
    if ceiling is not None:
        found = np.minimum(found, ceiling)
    return Foci(places + origin, found, assignment, sigma)


def reconstruct(foci: Foci, positions: ArrayLike) -> Real:
    """Pressure that foci give [Pa], shape [P]: a Gaussian about each, in its own Voronoi region.

    Args:
        foci: The foci.
        positions: Points [m], shape [P, 3].
    """
    points = np.asarray(positions, np.float64).reshape(-1, 3)
    if foci.count == 0:
        return np.zeros(len(points))
    origin = foci.positions[0]
    assignment, square = _nearest(_rows(points, origin), foci.positions - origin)
    return np.asarray(foci.pressures[assignment] * np.exp(square * (-0.5 / foci.sigma**2)))


def _rows(points: Real, origin: Real) -> NDArray[np.float32]:
    """Coordinates relative to a point nearby [m], shape [3, P]."""
    return np.ascontiguousarray((points - origin).T, np.float32)


def _nearest(rows: NDArray[np.float32], places: Real) -> tuple[NDArray[np.intp], Real]:
    """Nearest place of each point and the square of its distance [m²], both of shape [P]."""
    local = places.astype(np.float32)
    half = local @ rows
    half -= 0.5 * np.square(local).sum(1)[:, None]
    square = np.einsum("im,im->m", rows, rows) - 2.0 * half.max(0)
    return half.argmax(0), np.maximum(square, 0.0).astype(np.float64)
