# SPDX-License-Identifier: GPL-3.0-or-later
"""Positions and pressures of focal points, clustered from a pressure field.

After section IV-B of Barreiro, Torres and Otaduy, *Natural Tactile Interaction with Virtual Clay*,
WHC 2021. The clustering is from Barreiro, Sinclair and Otaduy, "Ultrasound rendering of tactile
interaction with fluids", WHC 2019 (10.1109/WHC.2019.8816137), with the seeds of Arthur and
Vassilvitskii, "k-means++", SODA 2007.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .clusters import Clusters

PRESSURE_RULES = ("least_squares", "printed")
"""How to compute the pressure of a focus: the minimizer of equation 9, or the paper's formula."""

_SNAP = 0.3
"""Standard deviation of the mean that moves a center onto the skin, in sigmas."""

Real = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Foci:
    """Focal points at one moment. A focus keeps its index from frame to frame while it exists."""

    positions: Real
    """Positions on the skin [m], shape [K, 3]."""
    pressures: Real
    """Focal pressure of each [Pa], shape [K]."""
    assignment: NDArray[np.intp]
    """Index of the focus nearest to each point of the field, shape [G]; -1 if there are no foci.
    Empty if the field is unknown."""
    sigma: float
    """Standard deviation of the Gaussian that models a focus [m]."""

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
    """Choose focal points that approximate a pressure field.

    The positions are a weighted k-means clustering of α p* (equation 8), seeded by k-means++ or by
    the previous foci; each is then moved onto the skin nearby. Their number follows the touched
    skin: a cluster is split if its standard deviation along its longest axis exceeds 0.75 sigma,
    and foci closer than one sigma, which no array of that wavelength can resolve, are merged. The
    pressures fit p* over the Voronoi region of each focus (equation 9). The least-squares solution
    is Σ p* G / Σ G², where G is the Gaussian; the paper prints Σ p* G / Σ G, which is too small
    (``rule="printed"``). Equation 9 does not contain α; with it, the error on the finger pads would
    improve by less than 1 %.

    Args:
        positions: Skin points [m], shape [G, 3].
        pressures: Target pressure p* at each [Pa], shape [G].
        weights: Perceptual weight α of each, shape [G].
        count: Maximum number of foci.
        sigma: Standard deviation of a focus, equal to the wavelength [m].
        previous: Foci of the previous frame, to start from.
        rule: One of `PRESSURE_RULES`.
        ceiling: Maximum pressure of a focus [Pa]; None for no limit.

    Returns:
        At most `count` foci; none if nothing is touched.

    Raises:
        ValueError: Shapes do not match, values are negative or not finite, or an option is invalid.
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
    # A finite sum means that all values are finite, and is faster than testing each.
    if not math.isfinite(float(points.sum()) + float(mass.sum()) + float(target.sum())):
        raise ValueError("Positions, pressures and weights of a field must be finite.")
    if mass.min(initial=0.0) < 0.0 or target.min(initial=0.0) < 0.0:
        raise ValueError("Pressures and weights of a field must be at least 0.")
    touched = np.flatnonzero(mass)
    if count == 0 or len(touched) == 0:
        unassigned = np.full(len(target), -1, np.intp)
        return Foci(np.zeros((0, 3)), np.zeros(0), unassigned, sigma)
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
    gaussian = np.exp(square * (-0.5 / sigma**2))
    numerator = np.bincount(assignment, target * gaussian, len(places))
    squared = gaussian if rule == "printed" else gaussian * gaussian
    denominator = np.bincount(assignment, squared, len(places))
    fitted = numerator / np.maximum(denominator, 1e-300)
    if ceiling is not None:
        fitted = np.minimum(fitted, ceiling)
    return Foci(places + origin, fitted, assignment, sigma)


def reconstruct(foci: Foci, positions: ArrayLike) -> Real:
    """Pressure that foci produce, a Gaussian around each in its Voronoi region [Pa], shape [P].

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
    """Coordinates relative to a nearby point [m], shape [3, P]."""
    return np.ascontiguousarray((points - origin).T, np.float32)


def _nearest(rows: NDArray[np.float32], places: Real) -> tuple[NDArray[np.intp], Real]:
    """Index of the place nearest to each point, and squared distance [m²], both of shape [P]."""
    local = places.astype(np.float32)
    half = local @ rows
    half -= 0.5 * np.square(local).sum(1)[:, None]
    square = np.einsum("im,im->m", rows, rows) - 2.0 * half.max(0)
    return half.argmax(0), np.maximum(square, 0.0).astype(np.float64)
