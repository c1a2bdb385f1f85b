# SPDX-License-Identifier: GPL-3.0-or-later
"""Live, held, lost: how hands appear, are held, are lost and reappear."""

import numpy as np
import pytest

from tactile_clay.clay_addon.core.tracking.hand.presence import Presence
from tactile_clay.clay_addon.core.tracking.protocol.joints import ALL_JOINTS, WRIST
from tactile_clay.tests.clay_addon.core.tracking.hands import Clock, frame_at, shown


class Person:
    """A slightly trembling hand in front of a tracker with 100 frames/s."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.presence = Presence("right")
        self.number = 0

    def show(self, milliseconds: float, *, still: bool = False, at=(0.0, 0.2, 0.0), **options):
        """Show the hand for some time, and return it at the end."""
        for _ in range(round(milliseconds / 10)):
            self.number += 1
            tremor = 0.0 if still else 1e-5 * (self.number % 2)
            place = np.add(at, (tremor, 0.0, 0.0))
            now = self.clock.turn(10)
            self.presence.take(frame_at(now, self.number, at=place, **options), now)
        return self.presence.hand(self.clock.now)

    def hide(self, milliseconds: float):
        """Send no frames for some time, and return the hand at the end."""
        return self.presence.hand(self.clock.turn(milliseconds))


@pytest.fixture
def person(clock: Clock) -> Person:
    """A person whose hand has not been seen yet."""
    return Person(clock)


def test_hand_is_none_before_it_is_seen(person: Person) -> None:
    """Return no hand before the first frame."""
    assert person.hide(100) is None


def test_contact_of_a_new_hand_grows_in_a_fifth_of_a_second(person: Person) -> None:
    """Start without contact, reach half after 0.1 s and full contact after 0.2 s."""
    assert person.show(10).contact == 0.0
    assert person.show(100).contact == pytest.approx(0.5)
    hand = person.show(100)
    assert (hand.state, hand.contact) == ("live", pytest.approx(1.0))


def test_hand_without_frames_is_held_then_lost(person: Person) -> None:
    """Hold it for 0.2 s, with contact fading in the second half; then lose it."""
    person.show(500)
    assert person.hide(90).state == "live"
    held = person.hide(60)
    assert (held.state, held.contact) == ("held", pytest.approx(0.5))
    lost = person.hide(60)
    assert (lost.state, lost.contact) == ("lost", 0.0)
    assert np.array_equal(lost.positions, held.positions)


def test_short_gap_keeps_contact(person: Person) -> None:
    """Keep full contact through the longest gap of a Leap recording."""
    person.show(500)
    assert person.hide(30).contact == 1.0
    assert person.show(10).contact == 1.0


@pytest.mark.parametrize(
    "options", [{"confidence": 0.1}, {"active": False}, {"valid": ALL_JOINTS & ~(1 << WRIST)}]
)
def test_distrusted_hand_keeps_its_pose_and_is_lost(person: Person, options) -> None:
    """Keep the last trusted pose, and lose the hand after 0.2 s."""
    before = person.show(500)
    held = person.show(50, at=(0.5, 0.5, 0.5), **options)
    assert held.state == "held"
    assert np.array_equal(held.positions, before.positions)
    lost = person.show(160, at=(0.5, 0.5, 0.5), **options)
    assert (lost.state, lost.contact) == ("lost", 0.0)


def test_regaining_trust_needs_a_higher_confidence(person: Person) -> None:
    """Trust a confidence of 0.35 for a live hand, but not for a distrusted one."""
    assert person.show(100, confidence=0.35) is None
    person.show(100, confidence=0.9)
    assert person.show(100, confidence=0.35).state == "live"
    person.show(20, confidence=0.2)
    assert person.show(20, confidence=0.35).state == "held"
    assert person.show(20, confidence=0.45).state == "live"


def test_frozen_hand_is_lost(person: Person) -> None:
    """Lose a hand whose frames are bit-identical for 0.5 s."""
    person.show(500)
    assert person.show(480, still=True).state == "live"
    lost = person.show(60, still=True)
    assert (lost.state, lost.contact) == ("lost", 0.0)
    back = person.show(20)
    assert back.state == "live"
    assert back.contact < 0.2


def test_reappearing_hand_starts_unfiltered_without_contact(person: Person) -> None:
    """Show a reappearing hand at its true position at once, and let contact grow."""
    person.show(500)
    person.hide(1000)
    back = person.show(10, at=(0.3, 0.1, 0.0))
    assert back.contact == 0.0
    assert np.allclose(back.positions[WRIST], (0.3, 0.1, 0.0), atol=1e-4)
    assert person.show(210, at=(0.3, 0.1, 0.0)).contact == pytest.approx(1.0)


def test_jumping_hand_loses_contact(person: Person) -> None:
    """Follow an 18 cm jump between two frames at once, and let contact grow from zero."""
    person.show(500)
    jumped = person.show(10, at=(0.18, 0.2, 0.0))
    assert jumped.state == "live"
    assert jumped.contact == 0.0
    assert np.allclose(jumped.positions[WRIST], (0.18, 0.2, 0.0), atol=1e-4)


def test_fast_hand_keeps_its_contact(person: Person) -> None:
    """Treat 4 m/s as motion, not as a jump."""
    person.show(500)
    for step in range(10):
        hand = person.show(10, at=(0.04 * step, 0.2, 0.0))
    assert hand.contact == 1.0


def test_delayed_frame_is_not_live(person: Person, clock: Clock) -> None:
    """Show a hand as lost if its frame is 0.3 s old when it arrives."""
    person.show(500)
    now = clock.turn(1000)
    person.presence.take(frame_at(now, 10_000), now - 300_000_000)
    hand = shown(person.presence.hand(now))
    assert (hand.state, hand.contact) == ("lost", 0.0)
