# SPDX-License-Identifier: GPL-3.0-or-later
"""Following two hands, and trackers that confuse them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile_clay.clay_addon.core.tracking.hand.hand_tracker import HandTracker
from tactile_clay.clay_addon.core.tracking.protocol.joints import SIDES, WRIST
from tactile_clay.tests.clay_addon.core.tracking.hands import MILLISECOND, Clock, frame_at, shown

HOMES = {"left": np.array([-0.2, 0.2, 0.0]), "right": np.array([0.2, 0.2, 0.0])}
OTHER = {"left": "right", "right": "left"}


class Scene:
    """Both hands in front of a tracker, moving slowly."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.tracker = HandTracker()
        self.number = 0

    def show(self, frames: int, *, sides=SIDES, swapped: bool = False):
        """Show hands for a number of frames, and return the hands at the end."""
        for _ in range(frames):
            self.number += 1
            now = self.clock.turn(9)
            for side in sides:
                label = OTHER[side] if swapped else side
                place = HOMES[side] + [0.0, 1e-4 * self.number, 0.0]
                self.tracker.take(frame_at(now, self.number, label, place), now)
        return {side: self.tracker.hand(side, self.clock.now) for side in SIDES}


@pytest.fixture
def scene(clock: Clock) -> Scene:
    """A scene in which no hand has been shown yet."""
    return Scene(clock)


def at_home(hand) -> bool:
    """Whether a hand is near its own position."""
    return float(np.linalg.norm(hand.positions[WRIST] - HOMES[hand.side])) < 0.05


def test_both_hands_are_live_each_on_its_side(scene: Scene) -> None:
    """Follow two hands at once."""
    hands = scene.show(50)
    assert all(hand.state == "live" and hand.contact == 1.0 for hand in hands.values())
    assert all(at_home(hand) for hand in hands.values())


@pytest.mark.parametrize("frames", [1, 3, 8])
def test_short_swap_is_ignored(scene: Scene, frames: int) -> None:
    """Keep each hand's pose and contact until the tracker is right again."""
    scene.show(50)
    during = scene.show(frames, swapped=True)
    assert all(at_home(hand) and hand.contact == 1.0 for hand in during.values())
    after = scene.show(1)
    assert all(hand.state == "live" and hand.contact == 1.0 for hand in after.values())
    assert scene.tracker.ignored == 2 * frames


def test_short_swap_of_a_single_hand_shows_no_second_hand(scene: Scene) -> None:
    """Ignore frames that label the only hand as the other side."""
    scene.show(50, sides=["right"])
    during = scene.show(8, sides=["right"], swapped=True)
    assert during["left"] is None
    assert at_home(during["right"])
    assert scene.show(1, sides=["right"])["right"].contact == 1.0


def test_lasting_swap_is_accepted_like_a_jump(scene: Scene) -> None:
    """Move the hands after a quarter of a second, with contact growing from zero."""
    scene.show(50)
    touching = []
    for _ in range(40):
        hands = scene.show(1, swapped=True)
        touching += [hand.contact for hand in hands.values() if not at_home(hand)]
    assert not any(at_home(hand) for hand in hands.values())
    assert touching[0] == 0.0
    assert max(np.diff(touching[::2])) < 0.05


def test_hand_reported_as_both_sides_stays_one(scene: Scene) -> None:
    """Never show a left hand at the same position as the right one."""
    scene.show(50, sides=["right"])
    for _ in range(100):
        scene.number += 1
        now = scene.clock.turn(9)
        place = HOMES["right"] + [0.0, 1e-4 * scene.number, 0.0]
        for side in SIDES:
            scene.tracker.take(frame_at(now, scene.number, side, place), now)
    assert scene.tracker.hand("left", now) is None
    assert shown(scene.tracker.hand("right", now)).contact == 1.0


def test_hands_may_come_together_and_cross(scene: Scene) -> None:
    """Keep both hands live while they touch, because each has moved there continuously."""
    scene.show(50)
    for step in np.linspace(1.0, -1.0, 120):
        scene.number += 1
        now = scene.clock.turn(9)
        for side in SIDES:
            place = HOMES[side] * [step, 1.0, 1.0] + [0.0, 1e-4 * scene.number, 0.0]
            scene.tracker.take(frame_at(now, scene.number, side, place), now)
    hands = [shown(scene.tracker.hand(side, now)) for side in SIDES]
    assert all(hand.state == "live" and hand.contact == 1.0 for hand in hands)
    assert scene.tracker.ignored == 0


def test_hand_lost_next_to_the_other_reappears_at_once(scene: Scene) -> None:
    """Accept a hand where it was lost, even close to the other one."""
    together = {"left": np.array([-0.03, 0.2, 0.0]), "right": np.array([0.03, 0.2, 0.0])}

    def show(frames: int, confidence: float) -> None:
        for _ in range(frames):
            scene.number += 1
            now = scene.clock.turn(9)
            for side in SIDES:
                place = together[side] + [0.0, 1e-5 * scene.number, 0.0]
                frame = frame_at(
                    now, scene.number, side, place, confidence=confidence if side == "left" else 1.0
                )
                scene.tracker.take(frame, now)

    show(60, 1.0)
    show(40, 0.1)
    assert shown(scene.tracker.hand("left", scene.clock.now)).state == "lost"
    show(1, 1.0)
    assert shown(scene.tracker.hand("left", scene.clock.now)).state == "live"


steps = st.tuples(
    st.integers(0, 300),
    st.sampled_from(SIDES),
    st.floats(-0.4, 0.4),
    st.sampled_from([0.0, 0.1, 0.35, 0.9]),
    st.booleans(),
    st.integers(0, 400),
)


@settings(max_examples=60)
@given(st.lists(steps, max_size=40))
def test_no_stale_hand_is_ever_shown_as_live(steps) -> None:
    """Show a hand as live only within 0.1 s of a trusted frame, and never let contact jump up."""
    clock, tracker = Clock(), HandTracker()
    seen = dict.fromkeys(SIDES, -1)
    contacts = dict.fromkeys(SIDES, 0.0)
    times = dict.fromkeys(SIDES, clock.now)
    for number, (wait, side, x, confidence, active, age) in enumerate(steps):
        now = clock.turn(wait)
        moment = now - age * MILLISECOND
        frame = frame_at(now, number, side, (x, 0.2, 0), confidence=confidence, active=active)
        tracker.take(frame, moment)
        if active and confidence >= 0.3:
            seen[side] = max(seen[side], moment)
        for each in SIDES:
            hand = tracker.hand(each, now)
            if hand is None:
                continue
            assert np.isfinite(hand.positions).all()
            assert 0.0 <= hand.contact <= 1.0
            if hand.state == "live":
                assert now - seen[each] <= 100 * MILLISECOND
            if hand.state == "lost":
                assert hand.contact == 0.0
            grown = hand.contact - contacts[each]
            since = min(times[each], moment) if each == side else times[each]
            assert grown <= (now - since) * 1e-9 / 0.2 + 1e-9
            contacts[each], times[each] = hand.contact, now
