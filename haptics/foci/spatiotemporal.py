# SPDX-License-Identifier: GPL-3.0-or-later
"""Spatiotemporal modulation: foci that run along a route over all touched skin.

The paper renders by amplitude modulation, whose few foci cannot cover a palm, and names routes as
what to try next; the problem is that of Barreiro, Sinclair and Otaduy, "Path Routing Optimization
for STM Ultrasound Rendering", IEEE Trans. Haptics 13(1), 2020. Its text was not at hand: the
solution here is our own. Skin feels a moving focus most strongly at 5 to 8 m/s, the speed of waves
in it (Frier et al., "Using Spatiotemporal Modulation to Draw Tactile Patterns in Mid-Air",
EuroHaptics 2018).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .tour import closed_tour, spread_stops

SPEED_LIMIT = 8.0
"""Fastest a focus runs [m/s]."""
UPDATE_RATE = 40e3
"""How often an array can move it [1/s]."""
_REPEAT_RATE = 200.0
"""A place need not be passed more often [1/s]: touch is finest there, and slower foci are surer."""
_TOUCHED = 0.05
"""Skin with a smaller part of the greatest weighted pressure is no stop."""
_REACH = 1.0
"""How far a stop serves, over sigma: neighboring lanes of the route then lie within 2 sigma, where
Gaussians add up to an even field within 2 %."""
_NODE = 0.3
"""Distance of the places where the pressure is solved for, over sigma."""
_APART, _SELDOM = 1.5, 0.1
"""Foci nearer than the first, over sigma, disturb each other; that may be in the second part of a
round, else there are fewer foci."""
_CIRCLE = 0.35
"""Radius of the least route, over sigma."""
_SWEEPS = 12
_LARGEST = 1.5
"""No place gets more than so many times the root mean square along the route: a peak would cost
the whole field strength, and fits little better."""

Real = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Route:
    """A closed route with a pressure at each place; several foci follow each other on it."""

    positions: Real
    """Place of a focus at each update of the array, through one round [m], shape [S, 3]."""
    pressures: Real
    """Pressure of a focus at each place [Pa], shape [S]."""
    focus_count: int
    """Foci that run on it, the same time behind each other."""
    sigma: float
    """Standard deviation of the Gaussian that a focus is taken for [m]."""
    gain: float
    """The time average over what is wanted: less than 1 where foci would have to be stronger."""
    stops: Real
    """Stops in the order of the route, which the next frame starts from [m], shape [N, 3]."""

    @property
    def length(self) -> float:
        """Length of the route [m]."""
        return float(self._steps().sum())

    @property
    def speed(self) -> float:
        """How fast a focus runs at most [m/s]."""
        return float(self._steps().max(initial=0.0)) * UPDATE_RATE

    @property
    def period(self) -> float:
        """Time of one round [s]."""
        return len(self.positions) / UPDATE_RATE

    @property
    def repeat_rate(self) -> float:
        """How often a focus passes each place [1/s]."""
        return self.focus_count / self.period if self.period > 0.0 else 0.0

    def _steps(self) -> Real:
        """Way from each place to the next [m], shape [S]."""
        return np.linalg.norm(np.roll(self.positions, -1, 0) - self.positions, axis=1)

    def at(self, time: float) -> tuple[Real, Real]:
        """Foci at a moment.

        Args:
            time: Since the round began [s].

        Returns:
            Positions [m], shape [M, 3], and pressures [Pa], shape [M]; none on an empty route.
        """
        count = len(self.positions)
        if count == 0:
            return np.zeros((0, 3)), np.zeros(0)
        places = (time / self.period + np.arange(self.focus_count) / self.focus_count) % 1.0 * count
        index = places.astype(np.intp) % count
        part = (places - index)[:, None]
        after = (index + 1) % count
        here = self.positions[index] * (1.0 - part) + self.positions[after] * part
        return here, self.pressures[index] * (1 - part[:, 0]) + self.pressures[after] * part[:, 0]

    def time_average(self, points: ArrayLike) -> Real:
        """Mean over a round of the pressure that all foci give at points [Pa], shape [P]."""
        where = np.asarray(points, np.float64).reshape(-1, 3)
        if len(self.positions) == 0:
            return np.zeros(len(where))
        falls = _falls(where, self.positions, self.sigma)
        return np.asarray(falls @ self.pressures * (self.focus_count / len(self.positions)))

    def largest(self, points: ArrayLike) -> Real:
        """Greatest pressure over a round at points [Pa], shape [P]: what passes over the skin."""
        where = np.asarray(points, np.float64).reshape(-1, 3)
        if len(self.positions) == 0:
            return np.zeros(len(where))
        return np.asarray((_falls(where, self.positions, self.sigma) * self.pressures).max(1))


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
    """Lay a closed route over a pressure field, so that the time average of the foci on it fits.

    Stops are spread over the touched skin and joined by a short tour; the way between them is laid
    onto the skin; then the pressure along it is solved for: the least-squares fit, weighted by α
    and never below 0, of the time average to p* (multiplicative updates of De Pierro, 1987). Where
    the ceiling allows no more, the whole field is weaker by one gain.

    Takes about 7 ms for 2,000 points over 97 cm² of touched skin, on one core.

    Args:
        positions: Points of the skin [m], shape [G, 3].
        pressures: Target pressure p* at each [Pa], shape [G].
        weights: Perceptual weight α of each, shape [G].
        sigma: Standard deviation of a focus, the wavelength [m].
        focus_count: Foci that run on it at the same time; fewer where they would come too near to
            each other.
        ceiling: Greatest pressure of a focus [Pa].
        speed: Fastest a focus may run [m/s].
        previous: Route of the frame before, whose stops are kept where they still serve.

    Returns:
        The route; without places where nothing is touched.

    Raises:
        ValueError: Shapes do not fit, or an option is out of its range.
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
    wanted = alpha * target
    if len(wanted) == 0 or wanted.max() <= 0.0:
        nothing = np.zeros((0, 3))
        return Route(nothing, np.zeros(0), focus_count, sigma, 1.0, nothing)
    touched = points[wanted > _TOUCHED * wanted.max()]
    kept = None if previous is None or len(previous.stops) == 0 else previous.stops
    start = int(wanted[wanted > _TOUCHED * wanted.max()].argmax())
    stops, known = spread_stops(touched, _REACH * sigma, first=start, kept=kept)
    corners = stops = stops[closed_tour(stops, known)]
    # Two separate fingertips are joined by a line there and back.
    if len(corners) < 3 and np.linalg.norm(corners - corners[0], axis=1).max() < 2.0 * sigma:
        corners = _circle(touched, corners.mean(0), sigma)
    nodes = _resampled(corners, _NODE * sigma)
    nodes = _resampled(_laid_on(touched, nodes, 0.3 * sigma), _NODE * sigma)
    focus_count = _most_apart(nodes, focus_count, _APART * sigma)
    near = _near(points, nodes, 3.0 * sigma)
    solved = _fitted(_falls(points[near], nodes, sigma), target[near], alpha[near])
    # The average of a place that is passed is its pressure by the share of time spent there.
    strength = solved * (len(nodes) / focus_count)
    gain = min(1.0, ceiling / max(float(strength.max()), 1e-300))
    step = float(np.linalg.norm(np.roll(nodes, -1, 0) - nodes, axis=1).max())
    slowest = math.ceil(len(nodes) * step * UPDATE_RATE / speed)
    count = max(len(nodes), slowest, math.ceil(focus_count * UPDATE_RATE / _REPEAT_RATE))
    places = np.arange(count) * (len(nodes) / count)
    index = places.astype(np.intp)
    part = places - index
    after = (index + 1) % len(nodes)
    route = nodes[index] * (1.0 - part)[:, None] + nodes[after] * part[:, None]
    strength = gain * (strength[index] * (1.0 - part) + strength[after] * part)
    return Route(route, strength, focus_count, sigma, gain, stops)


def _circle(touched: Real, middle: Real, sigma: float) -> Real:
    """Corners of a small round on skin, where contact is too small for a tour [m], shape [8, 3]."""
    near = touched[np.square(touched - middle).sum(1) < (1.5 * sigma) ** 2]
    offset = near - near.mean(0) if len(near) > 2 else np.eye(3)
    axes = np.linalg.svd(offset, full_matrices=False)[2]
    angle = np.arange(8) * (0.25 * math.pi)
    return np.asarray(
        middle
        + _CIRCLE * sigma * (np.outer(np.cos(angle), axes[0]) + np.outer(np.sin(angle), axes[1]))
    )


def _resampled(corners: Real, spacing: float) -> Real:
    """Places at equal distances, about `spacing`, along a closed line [m], shape [S, 3]."""
    closed = np.vstack((corners, corners[:1]))
    way = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))))
    count = max(8, math.ceil(way[-1] / spacing))
    places = np.arange(count) * (way[-1] / count)
    return np.stack([np.interp(places, way, closed[:, axis]) for axis in range(3)], axis=1)


def _laid_on(touched: Real, nodes: Real, reach: float) -> Real:
    """Nodes moved to the mean of the skin about the point next to them, where skin is near."""
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


def _most_apart(nodes: Real, most: int, distance: float) -> int:
    """How many foci can run on a route so that hardly ever two are nearer than a distance."""
    for count in range(most, 1, -1):
        near = np.zeros(len(nodes), bool)
        for other in range(1, count // 2 + 1):
            behind = np.roll(nodes, -round(len(nodes) * other / count), axis=0)
            near |= np.square(nodes - behind).sum(1) < distance * distance
        if near.mean() <= _SELDOM:
            return count
    return 1


def _near(points: Real, nodes: Real, reach: float) -> NDArray[np.intp]:
    """Indices of the points that a route can reach."""
    low, high = nodes.min(0) - reach, nodes.max(0) + reach
    return np.flatnonzero(((points > low) & (points < high)).all(1))


def _squares(first: Real, second: Real) -> NDArray[np.float32]:
    """Squares of all distances [m²], shape [A, B]."""
    middle = second.mean(0)
    a, b = (first - middle).astype(np.float32), (second - middle).astype(np.float32)
    square = a @ b.T
    square *= -2.0
    square += np.square(a).sum(1)[:, None]
    square += np.square(b).sum(1)
    return square


def _falls(points: Real, places: Real, sigma: float) -> NDArray[np.float32]:
    """The Gaussian of each place at each point, shape [P, S]."""
    exponent = _squares(points, places)
    exponent *= np.float32(-0.5 / sigma**2)
    np.maximum(exponent, np.float32(-30.0), out=exponent)
    return np.asarray(np.exp(exponent, out=exponent))


def _fitted(falls: NDArray[np.float32], target: Real, alpha: Real) -> Real:
    """Strengths, none below 0, whose sum of Gaussians fits the target, shape [S]."""
    weight = alpha.astype(np.float32)
    above = (weight * target.astype(np.float32)) @ falls
    strength = np.full(falls.shape[1], target.mean() / falls.sum(1).mean(), np.float32)
    for _ in range(_SWEEPS):
        strength *= above / np.maximum((weight * (falls @ strength)) @ falls, np.float32(1e-20))
        np.minimum(strength, _LARGEST * np.sqrt(np.square(strength).mean()), out=strength)
    return strength.astype(np.float64)
