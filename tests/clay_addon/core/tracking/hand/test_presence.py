# SPDX-License-Identifier: GPL-3.0-or-later
"""Live, held, lost: how a hand comes, is held for a moment, goes and comes back."""

import numpy as np
import pytest

from tactile_clay.clay_addon.core.tracking.hand.presence import Presence
from tactile_clay.clay_addon.core.tracking.protocol.joints import ALL_JOINTS, WRIST
from tactile_clay.tests.clay_addon.core.tracking.hands import Clock, frame_at, shown


class Person:
    """A hand in front of a tracker at a hundred frames a second, trembling a little."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.presence = Presence("right")
        self.number = 0

    def show(self, milliseconds: float, *, still: bool = False, at=(0.0, 0.2, 0.0), **options):
        """Show the hand for so long; the hand at the end."""
        for _ in range(round(milliseconds / 10)):
            self.number += 1
            tremor = 0.0 if still else 1e-5 * (self.number % 2)
            place = np.add(at, (tremor, 0.0, 0.0))
            now = self.clock.turn(10)
            self.presence.take(frame_at(now, self.number, at=place, **options), now)
        return self.presence.hand(self.clock.now)

    def hide(self, milliseconds: float):
        """Show nothing for so long; the hand at the end."""
        return self.presence.hand(self.clock.turn(milliseconds))


@pytest.fixture
def person(clock: Clock) -> Person:
    """A person who has not shown a hand yet."""
    return Person(clock)


def test_hand_that_was_never_there_is_none(person: Person) -> None:
    """Show no hand before the first."""
    assert person.hide(100) is None


def test_contact_of_a_hand_that_comes_grows_in_a_fifth_of_a_second(person: Person) -> None:
    """Touch nothing at first, half after 0.1 s, all after 0.2 s."""
    assert person.show(10).contact == 0.0
    assert person.show(100).contact == pytest.approx(0.5)
    hand = person.show(100)
    assert (hand.state, hand.contact) == ("live", pytest.approx(1.0))


def test_silent_hand_is_held_then_lost(person: Person) -> None:
    """Hold for 0.2 s, the contact fading in the second half, then touch nothing."""
    person.show(500)
    assert person.hide(90).state == "live"
    held = person.hide(60)
    assert (held.state, held.contact) == ("held", pytest.approx(0.5))
    lost = person.hide(60)
    assert (lost.state, lost.contact) == ("lost", 0.0)
    assert np.array_equal(lost.positions, held.positions)


def test_short_gap_does_no_harm(person: Person) -> None:
    """Keep the contact through a gap as long as a Leap's worst."""
    person.show(500)
    assert person.hide(30).contact == 1.0
    assert person.show(10).contact == 1.0


@pytest.mark.parametrize(
    "options", [{"confidence": 0.1}, {"active": False}, {"valid": ALL_JOINTS & ~(1 << WRIST)}]
)
def test_doubtful_hand_is_frozen_and_fades(person: Person, options) -> None:
    """Stay where the hand was last seen well, and lose it after 0.2 s."""
    before = person.show(500)
    held = person.show(50, at=(0.5, 0.5, 0.5), **options)
    assert held.state == "held"
    assert np.array_equal(held.positions, before.positions)
    lost = person.show(160, at=(0.5, 0.5, 0.5), **options)
    assert (lost.state, lost.contact) == ("lost", 0.0)


def test_confidence_must_pass_a_higher_bar_to_come_back(person: Person) -> None:
    """Believe 0.35 of a hand that is live, not of one that is in doubt."""
    assert person.show(100, confidence=0.35) is None
    person.show(100, confidence=0.9)
    assert person.show(100, confidence=0.35).state == "live"
    person.show(20, confidence=0.2)
    assert person.show(20, confidence=0.35).state == "held"
    assert person.show(20, confidence=0.45).state == "live"


def test_pose_that_does_not_change_by_a_bit_is_lost(person: Person) -> None:
    """Lose a hand that is bit-identical for 0.5 s though frames of it keep coming."""
    person.show(500)
    assert person.show(480, still=True).state == "live"
    lost = person.show(60, still=True)
    assert (lost.state, lost.contact) == ("lost", 0.0)
    back = person.show(20)
    assert back.state == "live"
    assert back.contact < 0.2


def test_returning_hand_touches_slowly_where_it_is(person: Person) -> None:
    """Take the place of a hand that comes back as it is, unfiltered, and let contact grow."""
    person.show(500)
    person.hide(1000)
    back = person.show(10, at=(0.3, 0.1, 0.0))
    assert back.contact == 0.0
    assert np.allclose(back.positions[WRIST], (0.3, 0.1, 0.0), atol=1e-4)
    assert person.show(210, at=(0.3, 0.1, 0.0)).contact == pytest.approx(1.0)


def test_jumping_hand_touches_slowly(person: Person) -> None:
    """Take an 18 cm jump between two frames at once, and let contact grow anew."""
    person.show(500)
    jumped = person.show(10, at=(0.18, 0.2, 0.0))
    assert jumped.state == "live"
    assert jumped.contact == 0.0
    assert np.allclose(jumped.positions[WRIST], (0.18, 0.2, 0.0), atol=1e-4)


def test_fast_hand_keeps_its_contact(person: Person) -> None:
    """Take 4 m/s for a hand that moves."""
    person.show(500)
    for step in range(10):
        hand = person.show(10, at=(0.04 * step, 0.2, 0.0))
    assert hand.contact == 1.0


def test_frame_that_was_long_on_its_way_is_not_live(person: Person, clock: Clock) -> None:
    """Show a hand as lost that was seen 0.3 s ago, though its frame comes now."""
    person.show(500)
    now = clock.turn(1000)
    person.presence.take(frame_at(now, 10_000), now - 300_000_000)
    hand = shown(person.presence.hand(now))
    assert (hand.state, hand.contact) == ("lost", 0.0)
