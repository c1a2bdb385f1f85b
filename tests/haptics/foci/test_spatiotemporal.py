# SPDX-License-Identifier: GPL-3.0-or-later
"""Routes: short, on the skin, within the speed limit, and covering more skin than a few foci."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tactile_clay.haptics import Route, focus, plan_route, reconstruct
from tactile_clay.haptics.foci.tour import closed_tour, spread_stops

SIGMA = 0.00865


def skin(size: float = 0.09, spacing: float = 0.003) -> np.ndarray:
    """A flat piece of skin."""
    axis = np.arange(-size / 2, size / 2 + 1e-9, spacing)
    return np.stack(np.meshgrid(axis, axis, [0.15], indexing="ij"), -1).reshape(-1, 3)


def length(stops: np.ndarray) -> float:
    """Length of the closed tour through stops in this order [m]."""
    return float(np.linalg.norm(stops - np.roll(stops, 1, axis=0), axis=1).sum())


def misfit(found: np.ndarray, target: np.ndarray) -> float:
    """Relative error of the shape, at the best common gain."""
    gain = found @ target / max(found @ found, 1e-30)
    return float(np.linalg.norm(gain * found - target) / np.linalg.norm(target))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_tour_of_few_stops_is_nearly_the_shortest(seed):
    """Come within 8 % of the shortest tour through seven stops."""
    stops = np.random.default_rng(seed).random((7, 3))
    best = min(length(stops[[0, *rest]]) for rest in permutations(range(1, 7)))
    assert length(stops[closed_tour(stops)]) <= 1.08 * best


def test_tour_of_a_grid_is_nearly_the_shortest():
    """Find a tour of a grid within 5 % of the shortest, which has one unit per stop."""
    grid = np.stack(np.meshgrid(np.arange(6), np.arange(6), [0.0]), -1).reshape(-1, 3)
    order = closed_tour(grid)
    assert sorted(order) == list(range(36))
    assert length(grid[order]) <= 1.05 * 36


def test_stops_cover_all_points():
    """Leave no point much farther from a stop than `reach`, without using too many stops."""
    points = skin()
    stops, known = spread_stops(points, SIGMA, first=0)
    assert known == 0
    distance = np.linalg.norm(points[:, None] - stops[None], axis=2).min(1)
    assert distance.max() < 1.5 * SIGMA
    # At best, a stop covers a hexagon of that radius, and half of one at the edges.
    assert len(stops) < 2.2 * 0.09**2 / (2.6 * SIGMA**2)


def test_further_stops_are_inserted_into_a_known_tour():
    """Keep a known tour, and insert new stops between their neighbors."""
    angle = np.arange(20) * 0.1 * np.pi
    ring = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    order = np.concatenate([np.arange(0, 20, 2), np.arange(1, 20, 2)])
    tour = closed_tour(ring[order], known=10)
    assert length(ring[order][tour]) == pytest.approx(length(ring))


def test_route_stays_within_its_speed_and_on_the_skin():
    """Obey the speed limit, in equal steps, on touched skin."""
    points = skin()
    pressures = np.where(np.hypot(points[:, 0], points[:, 1]) < 0.035, 500.0, 0.0)
    route = plan_route(points, pressures, np.ones(len(points)), sigma=SIGMA, speed=6.0)
    step = np.linalg.norm(np.roll(route.positions, -1, 0) - route.positions, axis=1)
    assert 5.0 < route.speed <= 6.0 + 1e-6
    assert step.max() <= 6.0 / 40e3 + 1e-9
    assert np.hypot(*route.positions[:, :2].T).max() < 0.035 + 0.003
    assert np.abs(route.positions[:, 2] - 0.15).max() < 1e-6
    assert route.repeat_rate == pytest.approx(
        route.focus_count * route.speed / route.length, rel=0.1
    )
    assert (route.pressures >= 0.0).all()
    assert route.pressures.max() <= 1000.0 + 1e-9


def test_moving_foci_give_the_time_average():
    """Average to `time_average` when the foci are followed through a round."""
    points = skin(0.06)
    pressures = np.where(np.abs(points[:, 0]) < 0.02, 300.0, 0.0)
    route = plan_route(points, pressures, np.ones(len(points)), sigma=SIGMA, focus_count=3)
    total = np.zeros(len(points))
    frames = 400
    for frame in range(frames):
        places, strengths = route.at((frame + 0.5) / frames * route.period)
        assert len(places) == 3
        square = np.square(points[:, None] - places[None]).sum(2)
        total += np.exp(-0.5 * square / SIGMA**2) @ strengths / frames
    assert np.allclose(total, route.time_average(points), rtol=0.01, atol=0.2)


@pytest.mark.parametrize(("radius", "factor"), [(0.025, 0.9), (0.035, 0.85), (0.042, 0.68)])
def test_routes_cover_large_contacts_that_eight_foci_cannot(radius, factor):
    """Fit a palm better than eight foci do, and more so the larger the contact."""
    points = skin()
    pressures = np.where(np.hypot(points[:, 0], points[:, 1]) < radius, 500.0, 0.0)
    even = np.ones(len(points))
    route = plan_route(points, pressures, even, sigma=SIGMA)
    foci = focus(points, pressures, even, sigma=SIGMA, count=8)
    moving = misfit(route.time_average(points), pressures)
    still = misfit(reconstruct(foci, points), pressures)
    assert moving < factor * still


def test_gain_is_the_ratio_of_average_to_target():
    """Average to the target times the gain, inside a large uniform contact."""
    points = skin()
    radius = np.hypot(points[:, 0], points[:, 1])
    pressures = np.where(radius < 0.04, 500.0, 0.0)
    route = plan_route(points, pressures, np.ones(len(points)), sigma=SIGMA)
    assert route.gain < 1.0
    inside = radius < 0.025
    average = route.time_average(points)[inside]
    assert average.mean() == pytest.approx(500.0 * route.gain, rel=0.06)
    assert average.std() < 0.12 * average.mean()


def test_a_small_contact_gets_a_small_circle():
    """Circle on a fingertip within half a wavelength, 200 times a second."""
    points = skin(0.03, 0.001)
    pressures = np.where(np.hypot(points[:, 0], points[:, 1]) < 0.004, 300.0, 0.0)
    route = plan_route(points, pressures, np.ones(len(points)), sigma=SIGMA, focus_count=1)
    assert np.hypot(*route.positions[:, :2].T).max() < 0.5 * SIGMA
    assert route.repeat_rate == pytest.approx(200.0, rel=0.05)


def test_two_separate_fingertips_are_both_rendered():
    """Press equally on two contacts that are each smaller than a focus."""
    points = skin(0.12, 0.002)
    tips = np.array(((-0.05, 0.0), (0.05, 0.0)))
    distance = np.linalg.norm(points[:, None, :2] - tips, axis=2)
    pressures = np.where(distance.min(1) < 0.004, 300.0, 0.0)
    route = plan_route(points, pressures, np.ones(len(points)), sigma=SIGMA, focus_count=2)
    average = route.time_average(points)
    left, right = (average[distance[:, tip] < 0.004].mean() for tip in (0, 1))
    assert left == pytest.approx(right, rel=0.1)
    assert left > 2.0 * average[np.abs(points[:, 0]) < 0.02].max()


def test_a_route_continues_from_the_previous_one():
    """Keep most stops while a load moves a little."""
    points = skin()
    even = np.ones(len(points))

    def load(x):
        return np.where(np.hypot(points[:, 0] - x, points[:, 1]) < 0.03, 500.0, 0.0)

    first = plan_route(points, load(0.0), even, sigma=SIGMA)
    second = plan_route(points, load(0.002), even, sigma=SIGMA, previous=first)
    distance = np.linalg.norm(second.stops[:, None] - first.stops[None], axis=2).min(1)
    assert np.median(distance) < 0.0025
    assert misfit(second.time_average(points), load(0.002)) < 0.4


def test_nothing_touched_is_an_empty_route():
    """Give an empty route if nothing is touched."""
    points = skin(0.03)
    route = plan_route(points, np.zeros(len(points)), np.ones(len(points)), sigma=SIGMA)
    assert isinstance(route, Route)
    assert len(route.at(0.1)[0]) == 0
    assert (route.time_average(points) == 0.0).all()
    assert (route.largest(points) == 0.0).all()
    assert (route.period, route.repeat_rate) == (0.0, 0.0)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 120), st.integers(1, 6))
@example(286, 2, 1)
def test_any_field_gives_a_valid_route(seed, size, foci):
    """Give finite positions and pressures on any scattered field."""
    random = np.random.default_rng(seed)
    points = random.uniform(-0.05, 0.05, (size, 3)) * random.choice([1.0, 1e-3, 0.0], 3)
    pressures = random.exponential(200.0, size)
    route = plan_route(points, pressures, random.random(size), sigma=SIGMA, focus_count=foci)
    assert np.isfinite(route.positions).all()
    assert np.isfinite(route.pressures).all()
    assert (route.pressures >= 0.0).all()
    assert 0.0 < route.gain <= 1.0


@pytest.mark.parametrize(
    "options", [{"sigma": 0.0}, {"speed": np.nan}, {"focus_count": 0}, {"ceiling": -1.0}]
)
def test_bad_options_are_refused(options):
    """Name the option that is out of range."""
    with pytest.raises(ValueError, match=next(iter(options))):
        plan_route(np.zeros((1, 3)), [1.0], [1.0], **({"sigma": SIGMA} | options))
