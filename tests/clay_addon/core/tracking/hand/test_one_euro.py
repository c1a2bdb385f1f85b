# SPDX-License-Identifier: GPL-3.0-or-later
"""The 1€ filter: still where the hand is still, there where the hand goes."""

import numpy as np
import pytest

from tactile_clay.clay_addon.core.tracking.hand.one_euro import (
    SMOOTHING,
    HandFilter,
    Smoothing,
    smoothing_share,
)
from tactile_clay.clay_addon.core.tracking.protocol.packet import SOURCES
from tactile_clay.solver.geometry.rotations import angles_between, matrices_from_quaternions
from tactile_clay.tests.clay_addon.core.tracking.hands import MILLISECOND

UPRIGHT = np.array([[0.0, 0.0, 0.0, 1.0]])
PLAIN = Smoothing(cutoff=1.0, speed_slope=0.0, turn_slope=0.0)
STEP = 10 * MILLISECOND


def filtered(positions, smoothing, quaternions=None):
    """Filter one joint's positions [N, 3], or its quaternions beside, a hundred times a second."""
    hand_filter = HandFilter()
    results = []
    for number, position in enumerate(positions):
        turn = UPRIGHT if quaternions is None else quaternions[number][None]
        results.append(hand_filter(number * STEP, position[None], turn, smoothing))
    return np.array([p[0] for p, _ in results]), np.array([q[0] for _, q in results])


def test_every_kind_of_tracker_has_its_strength() -> None:
    """Know how to filter whatever a datagram may say it is from."""
    assert set(SMOOTHING) == set(SOURCES)


def test_share_is_that_of_a_first_order_low_pass() -> None:
    """Take in 1 / (1 + τ / Δt) of a new value, τ being 1 / 2 π cutoff."""
    tau = 1.0 / (2.0 * np.pi * 3.0)
    assert smoothing_share(3.0, 0.01) == pytest.approx(1.0 / (1.0 + tau / 0.01))


def test_step_is_followed_as_by_a_low_pass() -> None:
    """Answer a step by the known exponential where speed changes nothing."""
    positions = np.zeros((100, 3))
    positions[1:, 0] = 1.0
    seen, _ = filtered(positions, PLAIN)
    share = smoothing_share(1.0, 0.01)
    assert np.allclose(seen[:, 0], 1.0 - (1.0 - share) ** np.arange(100))


@pytest.mark.parametrize("source", list(SMOOTHING))
def test_tremor_at_rest_is_filtered_away(source: str) -> None:
    """Leave less than half of a tracker's noise in a hand at rest, in place and in turn."""
    noise = np.random.default_rng(1).normal(0.0, 2e-4, (600, 3))
    angles = np.random.default_rng(2).normal(0.0, 0.004, 600)
    turns = np.stack([np.sin(angles / 2), 0 * angles, 0 * angles, np.cos(angles / 2)], axis=1)
    seen, turned = filtered(noise, SMOOTHING[source], turns)
    assert seen[100:].std() < 0.5 * noise.std()
    assert np.std(2 * turned[100:, 0]) < 0.5 * angles.std()


@pytest.mark.parametrize(("source", "delay"), [("leap", 0.008), ("openxr", 0.015)])
def test_moving_hand_is_followed_closely(source: str, delay: float) -> None:
    """Lag behind a hand moving at half a meter a second by less than so many seconds."""
    way = np.zeros((200, 3))
    way[:, 1] = 0.5 * 0.01 * np.arange(200)
    seen, _ = filtered(way, SMOOTHING[source])
    assert (way[-1, 1] - seen[-1, 1]) / 0.5 < delay


def test_result_turns_with_the_axes() -> None:
    """Filter a turned motion as the motion is, turned."""
    way = np.cumsum(np.random.default_rng(3).normal(0.0, 0.003, (50, 3)), axis=0)
    turn = matrices_from_quaternions(np.array([1.0, 2.0, 3.0, 4.0]) / np.sqrt(30.0))
    plain, _ = filtered(way, SMOOTHING["hts"])
    turned, _ = filtered(way @ turn.T, SMOOTHING["hts"])
    assert np.allclose(turned, plain @ turn.T)


def test_quaternions_keep_to_the_short_way() -> None:
    """Filter a turn that a tracker tells with the other sign as if it had not."""
    angles = np.linspace(0.0, 1.0, 100)
    turns = np.stack([np.sin(angles), 0 * angles, 0 * angles, np.cos(angles)], axis=1)
    signs = np.where(np.arange(100) % 2, -1.0, 1.0)[:, None]
    _, plain = filtered(np.zeros((100, 3)), SMOOTHING["leap"], turns)
    _, flipped = filtered(np.zeros((100, 3)), SMOOTHING["leap"], turns * signs)
    assert np.allclose(angles_between(plain, flipped), 0.0, atol=1e-6)
    assert angles_between(plain[-1], turns[-1]) < 0.1


def test_time_that_stands_changes_nothing_and_reset_begins_anew() -> None:
    """Ignore a frame of the same moment; take the first one after a reset as it is."""
    hand_filter = HandFilter()
    hand_filter(0, np.zeros((1, 3)), UPRIGHT, PLAIN)
    same, _ = hand_filter(0, np.ones((1, 3)), UPRIGHT, PLAIN)
    assert np.array_equal(same, np.zeros((1, 3)))
    hand_filter.reset()
    anew, _ = hand_filter(0, np.ones((1, 3)), UPRIGHT, PLAIN)
    assert np.array_equal(anew, np.ones((1, 3)))
