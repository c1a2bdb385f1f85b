# SPDX-License-Identifier: GPL-3.0-or-later
"""Resampling of recordings."""

import numpy as np
import pytest

from tactile_clay.clay_addon.core.tracking.hand.hand_tracker import HandTracker
from tactile_clay.clay_addon.core.tracking.protocol.joints import WRIST
from tactile_clay.clay_addon.core.tracking.recording.recording import Entry
from tactile_clay.clay_addon.core.tracking.recording.resample import resampled_hands
from tactile_clay.tests.clay_addon.core.tracking.hands import MILLISECOND, frame_at, shown

STEP = 9 * MILLISECOND


def moving(count: int, speed: float = 0.1, *, start: int = 0) -> list[Entry]:
    """A right hand that moves along X at a speed [m/s]; ``start`` is the first frame's number."""
    entries = []
    for number in range(start, start + count):
        time = number * STEP
        place = (speed * time * 1e-9, 0.2, 0.0)
        entries.append(Entry(time, frame_at(time, number, at=place)))
    return entries


def test_steady_motion_stays_steady() -> None:
    """Interpolate between frames, so that a steady hand moves steadily at any frame rate."""
    times = [round(number * 1e9 / 24) for number in range(40)]
    hands = resampled_hands(moving(400), times)["right"]
    steps = np.diff([shown(hand).positions[WRIST, 0] for hand in hands[20:]])
    assert steps == pytest.approx(0.1 / 24, rel=1e-3)


def test_hands_are_as_in_live_tracking() -> None:
    """Give the same hand and contact at a frame's time as live tracking."""
    entries = moving(100) + moving(50, start=200)
    tracker = HandTracker()
    times = [entry.time for entry in entries]
    hands = resampled_hands(entries, times)
    for entry, hand in zip(entries, hands["right"], strict=True):
        tracker.take(entry.frame, entry.time)
        live = shown(tracker.hand("right", entry.time))
        assert shown(hand).state == live.state
        assert shown(hand).contact == pytest.approx(live.contact)
        assert np.allclose(shown(hand).positions, live.positions, atol=1e-9)
    assert hands["left"] == [None] * len(times)


def test_gap_is_not_interpolated() -> None:
    """Hold and then lose the hand in a gap, at its last position."""
    entries = moving(100) + moving(50, start=200)
    end = entries[99].time
    times = [0, end + 150 * MILLISECOND, end + 500 * MILLISECOND]
    _, held, lost = map(shown, resampled_hands(entries, times)["right"])
    assert (held.state, lost.state, lost.contact) == ("held", "lost", 0.0)
    assert np.array_equal(held.positions, lost.positions)


def test_jump_is_not_interpolated() -> None:
    """Show no positions between the two ends of a jump."""
    before = moving(50, speed=0.001)
    after = [
        Entry(entry.time, frame_at(entry.time, index + 50, at=(0.5, 0.2, 0.001 * index)))
        for index, entry in enumerate(moving(50, start=50))
    ]
    times = list(range(0, 99 * STEP, MILLISECOND))
    hands = resampled_hands(before + after, times)["right"]
    x = [shown(hand).positions[WRIST, 0] for hand in hands]
    assert all(value < 0.01 or value > 0.49 for value in x)
