# SPDX-License-Identifier: GPL-3.0-or-later
"""A tracked hand in simulated time."""

import numpy as np
import pytest
from numpy.typing import NDArray

from tactile_clay.clay_addon.core.session.hand_path import CATCH_UP, MAX_LAG, HandPath, Moment

TICK = 1.0 / 60.0


def pose(x: float, turn: float = 0.0) -> NDArray[np.float64]:
    """Two bones at a place along x, turned about z."""
    matrix = np.eye(4)
    matrix[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    matrix[0, 3] = x
    return np.stack([matrix, matrix])


@pytest.mark.parametrize("factor", [0.1, 0.25, 0.5, 0.8, 1.0])
@pytest.mark.parametrize("speed", [0.2, 1.0, 3.0])
def test_the_clay_meets_a_hand_no_faster_than_it_moved(factor: float, speed: float) -> None:
    """Until it is a second behind, whatever part of real time the clay keeps up with."""
    path = HandPath()
    before, now = 0.0, 0.0
    fastest = 0.0
    while path.lag < 0.7 * MAX_LAG and now < 3.0:
        place = speed * now
        bones, tracked = path.advance(Moment(now, factor), pose(place, now), True)
        assert tracked
        assert bones[0, 0, 3] <= place + 1e-9
        fastest = max(fastest, (bones[0, 0, 3] - before) / (factor * TICK))
        before = bones[0, 0, 3]
        np.testing.assert_allclose(bones[0, :3, :3].T @ bones[0, :3, :3], np.eye(3), atol=1e-9)
        np.testing.assert_allclose(np.arctan2(bones[0, 1, 0], bones[0, 0, 0]), before / speed)
        now += TICK
    assert fastest <= CATCH_UP * speed + 1e-6


@pytest.mark.parametrize("jitter", [0.0, 0.3, 0.9])
def test_at_full_pace_the_hand_is_not_behind(jitter: float) -> None:
    """By no more than uneven frames make it."""
    rng = np.random.default_rng(0)
    path, now = HandPath(), 0.0
    for _ in range(600):
        path.advance(Moment(now, 1.0), pose(now), True)
        assert path.lag < 0.01 * TICK
        now += TICK * (1.0 + jitter * rng.uniform(-1.0, 1.0))


@pytest.mark.parametrize("factor", [0.05, 0.2, 0.5])
def test_the_hand_is_never_far_behind_and_arrives(factor: float) -> None:
    """It hurries where it must, and comes to rest where the hand does."""
    path, now = HandPath(), 0.0
    for _ in range(2000):
        path.advance(Moment(now, factor), pose(now), True)
        assert path.lag < 1.1 * MAX_LAG / factor
        now += TICK
    last = now
    for _ in range(2000):
        bones, _ = path.advance(Moment(now, 1.0), pose(last), True)
        now += TICK
    np.testing.assert_allclose(bones, pose(last))


def test_a_hand_that_was_lost_comes_where_it_is_found() -> None:
    """No path leads through the gap."""
    path = HandPath()
    for number in range(10):
        path.advance(Moment(number * TICK, 0.25), pose(0.0), True)
    for number in range(10, 12):
        path.advance(Moment(number * TICK, 0.25), pose(0.0), False)
    seen = []
    for number in range(12, 140):
        bones, tracked = path.advance(Moment(number * TICK, 0.25), pose(1.0), True)
        seen.append((float(bones[0, 0, 3]), tracked))
    assert (0.0, False) in seen
    assert seen[-1] == (1.0, True)
    assert all(x in (0.0, 1.0) for x, _ in seen)


def test_a_pose_that_is_no_number_is_passed_on() -> None:
    """Whoever takes it refuses it and says why."""
    path = HandPath()
    path.advance(Moment(0.0, 1.0), pose(0.0), True)
    bones, _ = path.advance(Moment(TICK, 1.0), np.full((2, 4, 4), np.nan), True)
    assert np.isnan(bones).all()
