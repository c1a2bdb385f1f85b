# SPDX-License-Identifier: GPL-3.0-or-later
"""Spatiotemporal modulation: foci that move along a route over all touched skin.

The clay paper uses amplitude modulation, whose few foci cannot cover a palm, and suggests routes as
future work. The problem is stated in Barreiro, Sinclair and Otaduy, "Path Routing Optimization for
STM Ultrasound Rendering", IEEE Trans. Haptics 13(1), 2020. The solution here was developed
independently, without access to that text. A moving focus is felt most strongly at 5 to 8 m/s, the
speed of waves in the skin (Frier et al., "Using Spatiotemporal Modulation to Draw Tactile Patterns
in Mid-Air", EuroHaptics 2018).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .tour import closed_tour, spread_stops

SPEED_LIMIT = 8.0
"""Maximum speed of a focus [m/s]."""
UPDATE_RATE = 40e3
"""Rate at which an array can move a focus [1/s]."""
_REPEAT_RATE = 200.0
"""Maximum rate at which a point is passed [1/s]: the skin is most sensitive at 200 Hz, and slower
foci are rendered more reliably."""
_TOUCHED = 0.05
"""Skin below this fraction of the maximum weighted pressure gets no stop."""
_REACH = 1.0
"""Radius that a stop covers, in sigmas: neighboring lanes of the route are then within 2 sigma,
where Gaussians add up to a field that is uniform within 2 %."""
_NODE = 0.3
"""Distance between the nodes at which the pressure is solved for, in sigmas."""
_INTERFERENCE, _MAX_INTERFERENCE = 1.5, 0.1
"""Foci closer than the first, in sigmas, interfere. If this happens during more than the second, a
fraction of the route, fewer foci are used."""
_CIRCLE = 0.35
"""Radius of the smallest route, in sigmas."""
_SWEEPS = 12
_MAX_OVER_RMS = 1.5
"""Maximum pressure at a node, relative to the root mean square along the route: a peak would weaken
the whole field and hardly improves the fit."""

Real = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Route:
    """A closed route with a pressure at each point; several foci follow each other along it."""

    positions: Real
    """Position of a focus at each update of the array during one round [m], shape [S, 3]."""
    pressures: Real
    """Pressure of a focus at each position [Pa], shape [S]."""
    focus_count: int
    """Number of foci on the route, equally spaced in time."""
    sigma: float
    """Standard deviation of the Gaussian that models a focus [m]."""
    gain: float
    """Time average relative to the target; less than 1 if foci would have to exceed the ceiling."""
    stops: Real
    """Stops in the order of the route, from which the next frame starts [m], shape [N, 3]."""

    @property
    def length(self) -> float:
        """Length of the route [m]."""
        return float(self._steps().sum())

    @property
    def speed(self) -> float:
        """Maximum speed of a focus [m/s]."""
        return float(self._steps().max(initial=0.0)) * UPDATE_RATE

    @property
    def period(self) -> float:
        """Duration of one round [s]."""
        return len(self.positions) / UPDATE_RATE

    @property
    def repeat_rate(self) -> float:
        """Rate at which foci pass each point of the route [1/s]."""
        return self.focus_count / self.period if self.period > 0.0 else 0.0

    def _steps(self) -> Real:
        """Distance from each position to the next [m], shape [S]."""
        return np.linalg.norm(np.roll(self.positions, -1, 0) - self.positions, axis=1)

    def at(self, time: float) -> tuple[Real, Real]:
        """Foci at one moment.

        Args:
            time: Time since the start of a round [s].

        Returns:
            Positions [m], shape [M, 3], and pressures [Pa], shape [M]; empty for an empty route.
        """
        count = len(self.positions)
        if count == 0:
            return np.zeros((0, 3)), np.zeros(0)
        places = (time / self.period + np.arange(self.focus_count) / self.focus_count) % 1.0 * count
        index = places.astype(np.intp) % count
        return (
            _interpolated(self.positions, places, index),
            _interpolated(self.pressures, places, index),
        )

    def time_average(self, points: ArrayLike) -> Real:
        """Mean pressure of all foci at points over a round [Pa], shape [P]."""
        skin = np.asarray(points, np.float64).reshape(-1, 3)
        if len(self.positions) == 0:
            return np.zeros(len(skin))
        gaussians = _gaussians(skin, self.positions, self.sigma)
        return np.asarray(gaussians @ self.pressures * (self.focus_count / len(self.positions)))

    def largest(self, points: ArrayLike) -> Real:
        """Maximum pressure of a passing focus at points over a round [Pa], shape [P]."""
        skin = np.asarray(points, np.float64).reshape(-1, 3)
        if len(self.positions) == 0:
            return np.zeros(len(skin))
        return np.asarray((_gaussians(skin, self.positions, self.sigma) * self.pressures).max(1))


def plan_route(
    positions: ArrayLike,
    pressures: ArrayLike,
    weights: ArrayLike,
    *,
    sigma: float,
    focus_count: int = 8,
    ceiling: float = 1000.0,
    speed: float = SPEED_LIMIT,
    previous: Route | None = None,
) -> Route:
    """Plan a closed route such that the time average of the foci on it fits a pressure field.

    Stops are spread over the touched skin and joined by a short tour, and the path between them is
    moved onto the skin. The pressure along it is the non-negative least-squares fit, weighted by α,
    of the time average to p* (multiplicative updates of De Pierro, 1987). If that exceeds the
    ceiling, the whole field is scaled down by one gain.

    Takes about 7 ms for 2,000 points over 97 cm² of touched skin, on one core.

    Args:
        positions: Skin points [m], shape [G, 3].
        pressures: Target pressure p* at each [Pa], shape [G].
        weights: Perceptual weight α of each, shape [G].
        sigma: Standard deviation of a focus, equal to the wavelength [m].
        focus_count: Maximum number of foci on the route; fewer if they would interfere.
        ceiling: Maximum pressure of a focus [Pa].
        speed: Maximum speed of a focus [m/s].
        previous: Route of the previous frame, whose stops are kept where still useful.

    Returns:
        The route; empty if nothing is touched.

    Raises:
        ValueError: Shapes do not match, or an option is out of range.
    """
    points = np.asarray(positions, np.float64)
    target, alpha = np.asarray(pressures, np.float64), np.asarray(weights, np.float64)
    if target.ndim != 1 or points.shape != (len(target), 3) or alpha.shape != target.shape:
        raise ValueError(
            f"A field has positions of shape {points.shape}, pressures of {target.shape} and "
            f"weights of {alpha.shape}; expected (G, 3), (G,) and (G,)."
        )
    options = {"sigma": sigma, "focus_count": focus_count, "ceiling": ceiling, "speed": speed}
    for name, value in options.items():
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} is {value!r}; it must be a number greater than 0.")
    weighted = alpha * target
    if len(weighted) == 0 or weighted.max() <= 0.0:
        nothing = np.zeros((0, 3))
        return Route(nothing, np.zeros(0), focus_count, sigma, 1.0, nothing)
    is_touched = weighted > _TOUCHED * weighted.max()
    touched = points[is_touched]
    kept = None if previous is None or len(previous.stops) == 0 else previous.stops
    start = int(weighted[is_touched].argmax())
    stops, known = spread_stops(touched, _REACH * sigma, first=start, kept=kept)
    corners = stops = stops[closed_tour(stops, known)]
    # Two separate fingertips are joined by a line there and back.
    if len(corners) < 3 and np.linalg.norm(corners - corners[0], axis=1).max() < 2.0 * sigma:
        corners = _circle(touched, corners.mean(0), sigma)
    nodes = _resampled(corners, _NODE * sigma)
    nodes = _resampled(_moved_onto(touched, nodes, 0.3 * sigma), _NODE * sigma)
    focus_count = _separate_foci(nodes, focus_count, _INTERFERENCE * sigma)
    near = _near(points, nodes, 3.0 * sigma)
    average = _fitted(_gaussians(points[near], nodes, sigma), target[near], alpha[near])
    # A focus spends only a fraction of the time at each node.
    strength = average * (len(nodes) / focus_count)
    gain = min(1.0, ceiling / max(float(strength.max()), 1e-300))
    step = float(np.linalg.norm(np.roll(nodes, -1, 0) - nodes, axis=1).max())
    count = max(
        len(nodes),
        math.ceil(len(nodes) * step * UPDATE_RATE / speed),
        math.ceil(focus_count * UPDATE_RATE / _REPEAT_RATE),
    )
    places = np.arange(count, dtype=np.float64) * (len(nodes) / count)
    index = places.astype(np.intp)
    return Route(
        _interpolated(nodes, places, index),
        gain * _interpolated(strength, places, index),
        focus_count,
        sigma,
        gain,
        stops,
    )


def _interpolated(values: Real, places: Real, index: NDArray[np.intp]) -> Real:
    """Values along a closed line at fractional places, whose integer parts are `index`."""
    fraction = (places - index).reshape(-1, *(1,) * (values.ndim - 1))
    after = (index + 1) % len(values)
    return np.asarray(values[index] * (1.0 - fraction) + values[after] * fraction)


def _circle(touched: Real, middle: Real, sigma: float) -> Real:
    """Corners of a small circle on skin whose contact is too small for a tour [m], shape [8, 3]."""
    near = touched[np.square(touched - middle).sum(1) < (1.5 * sigma) ** 2]
    offset = near - near.mean(0) if len(near) > 2 else np.eye(3)
    axes = np.linalg.svd(offset, full_matrices=False)[2]
    angle = np.arange(8) * (0.25 * math.pi)
    return np.asarray(
        middle
        + _CIRCLE * sigma * (np.outer(np.cos(angle), axes[0]) + np.outer(np.sin(angle), axes[1]))
    )


def _resampled(corners: Real, spacing: float) -> Real:
    """Points at equal distances of about `spacing` along a closed line [m], shape [S, 3]."""
    closed = np.vstack((corners, corners[:1]))
    length = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))))
    count = max(8, math.ceil(length[-1] / spacing))
    places = np.arange(count) * (length[-1] / count)
    return np.stack([np.interp(places, length, closed[:, axis]) for axis in range(3)], axis=1)


def _moved_onto(touched: Real, nodes: Real, reach: float) -> Real:
    """Move nodes near the skin to the mean of the skin around the nearest point [m], [S, 3]."""
    middle = touched.mean(0)
    square = _squares(nodes, touched)
    least = np.maximum(square.min(1), np.float32(0.0))
    square -= least[:, None]
    square *= np.float32(-0.5 / reach**2)
    np.maximum(square, np.float32(-30.0), out=square)
    weight = np.exp(square, out=square)
    total = weight @ (touched - middle).astype(np.float32)
    mean = total.astype(np.float64) / weight.sum(1)[:, None] + middle
    return np.where((least < (4.0 * reach) ** 2)[:, None], mean, nodes)


def _separate_foci(nodes: Real, highest: int, distance: float) -> int:
    """Maximum number of foci, up to `highest`, of which two are rarely closer than a distance."""
    for count in range(highest, 1, -1):
        near = np.zeros(len(nodes), bool)
        for other in range(1, count // 2 + 1):
            ahead = np.roll(nodes, -round(len(nodes) * other / count), axis=0)
            near |= np.square(nodes - ahead).sum(1) < distance * distance
        if near.mean() <= _MAX_INTERFERENCE:
            return count
    return 1


def _near(points: Real, nodes: Real, reach: float) -> NDArray[np.intp]:
    """Indices of the points within a distance of the bounding box of a route."""
    low, high = nodes.min(0) - reach, nodes.max(0) + reach
    return np.flatnonzero(((points > low) & (points < high)).all(1))


def _squares(first: Real, second: Real) -> NDArray[np.float32]:
    """Squared distances between all pairs [m²], shape [A, B]."""
    middle = second.mean(0)
    a, b = (first - middle).astype(np.float32), (second - middle).astype(np.float32)
    square = a @ b.T
    square *= -2.0
    square += np.square(a).sum(1)[:, None]
    square += np.square(b).sum(1)
    return square


def _gaussians(points: Real, centers: Real, sigma: float) -> NDArray[np.float32]:
    """The Gaussian around each center at each point, shape [P, S]."""
    exponent = _squares(points, centers)
    exponent *= np.float32(-0.5 / sigma**2)
    np.maximum(exponent, np.float32(-30.0), out=exponent)
    return np.asarray(np.exp(exponent, out=exponent))


def _fitted(gaussians: NDArray[np.float32], target: Real, alpha: Real) -> Real:
    """Non-negative coefficients with which a sum of Gaussians fits the target, shape [S]."""
    weight = alpha.astype(np.float32)
    numerator = (weight * target.astype(np.float32)) @ gaussians
    mean = target.mean() / gaussians.sum(1).mean()
    coefficients = np.full(gaussians.shape[1], mean, np.float32)
    for _ in range(_SWEEPS):
        denominator = (weight * (gaussians @ coefficients)) @ gaussians
        coefficients *= numerator / np.maximum(denominator, np.float32(1e-20))
        root_mean_square = np.sqrt(np.square(coefficients).mean())
        np.minimum(coefficients, _MAX_OVER_RMS * root_mean_square, out=coefficients)
    return coefficients.astype(np.float64)
