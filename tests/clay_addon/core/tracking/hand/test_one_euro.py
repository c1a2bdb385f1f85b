# SPDX-License-Identifier: GPL-3.0-or-later
"""The 1€ filter: smooth at rest, with little delay in motion."""

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
    """Filter one joint's positions [N, 3], and optionally its quaternions, at 100 frames/s."""
    hand_filter = HandFilter()
    results = []
    for number, position in enumerate(positions):
        turn = UPRIGHT if quaternions is None else quaternions[number][None]
        results.append(hand_filter(number * STEP, position[None], turn, smoothing))
    return np.array([p[0] for p, _ in results]), np.array([q[0] for _, q in results])


def test_every_kind_of_tracker_has_parameters() -> None:
    """Have parameters for every source that a datagram may name."""
    assert set(SMOOTHING) == set(SOURCES)


def test_share_is_that_of_a_first_order_low_pass() -> None:
    """Weight a new value by 1 / (1 + τ / Δt), where τ is 1 / (2 π cutoff)."""
    tau = 1.0 / (2.0 * np.pi * 3.0)
    assert smoothing_share(3.0, 0.01) == pytest.approx(1.0 / (1.0 + tau / 0.01))


def test_step_response_is_that_of_a_low_pass() -> None:
    """Respond to a step with the known exponential if speed has no effect."""
    positions = np.zeros((100, 3))
    positions[1:, 0] = 1.0
    seen, _ = filtered(positions, PLAIN)
    share = smoothing_share(1.0, 0.01)
    assert np.allclose(seen[:, 0], 1.0 - (1.0 - share) ** np.arange(100))


@pytest.mark.parametrize("source", list(SMOOTHING))
def test_noise_at_rest_is_filtered(source: str) -> None:
    """Halve a tracker's noise for a hand at rest at least, in position and orientation."""
    noise = np.random.default_rng(1).normal(0.0, 2e-4, (600, 3))
    angles = np.random.default_rng(2).normal(0.0, 0.004, 600)
    turns = np.stack([np.sin(angles / 2), 0 * angles, 0 * angles, np.cos(angles / 2)], axis=1)
    seen, turned = filtered(noise, SMOOTHING[source], turns)
    assert seen[100:].std() < 0.5 * noise.std()
    assert np.std(2 * turned[100:, 0]) < 0.5 * angles.std()


@pytest.mark.parametrize(("source", "delay"), [("leap", 0.008), ("openxr", 0.015)])
def test_moving_hand_is_followed_closely(source: str, delay: float) -> None:
    """Follow a hand moving at 0.5 m/s with less than this delay [s]."""
    way = np.zeros((200, 3))
    way[:, 1] = 0.5 * 0.01 * np.arange(200)
    seen, _ = filtered(way, SMOOTHING[source])
    assert (way[-1, 1] - seen[-1, 1]) / 0.5 < delay


def test_result_does_not_depend_on_the_axes() -> None:
    """Give the same result for a rotated motion, rotated."""
    way = np.cumsum(np.random.default_rng(3).normal(0.0, 0.003, (50, 3)), axis=0)
    turn = matrices_from_quaternions(np.array([1.0, 2.0, 3.0, 4.0]) / np.sqrt(30.0))
    plain, _ = filtered(way, SMOOTHING["hts"])
    turned, _ = filtered(way @ turn.T, SMOOTHING["hts"])
    assert np.allclose(turned, plain @ turn.T)


def test_sign_of_quaternions_does_not_matter() -> None:
    """Give the same result if a tracker's quaternions change sign."""
    angles = np.linspace(0.0, 1.0, 100)
    turns = np.stack([np.sin(angles), 0 * angles, 0 * angles, np.cos(angles)], axis=1)
    signs = np.where(np.arange(100) % 2, -1.0, 1.0)[:, None]
    _, plain = filtered(np.zeros((100, 3)), SMOOTHING["leap"], turns)
    _, flipped = filtered(np.zeros((100, 3)), SMOOTHING["leap"], turns * signs)
    assert np.allclose(angles_between(plain, flipped), 0.0, atol=1e-6)
    assert angles_between(plain[-1], turns[-1]) < 0.1


def test_frame_without_new_time_is_ignored_and_reset_clears_the_history() -> None:
    """Ignore a frame with the same time; pass the first one after a reset unfiltered."""
    hand_filter = HandFilter()
    hand_filter(0, np.zeros((1, 3)), UPRIGHT, PLAIN)
    same, _ = hand_filter(0, np.ones((1, 3)), UPRIGHT, PLAIN)
    assert np.array_equal(same, np.zeros((1, 3)))
    hand_filter.reset()
    fresh, _ = hand_filter(0, np.ones((1, 3)), UPRIGHT, PLAIN)
    assert np.array_equal(fresh, np.ones((1, 3)))
