# SPDX-License-Identifier: GPL-3.0-or-later
"""Resampling of recordings."""

from collections.abc import Sequence
from itertools import accumulate
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile_clay.clay_addon.core.tracking.hand.hand_tracker import HandTracker
from tactile_clay.clay_addon.core.tracking.hand.presence import TrackedHand
from tactile_clay.clay_addon.core.tracking.protocol.joints import SIDES, WRIST
from tactile_clay.clay_addon.core.tracking.recording import resample
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


frames = st.tuples(
    # Steps between frames: none, usual ones, a gap, one that loses the hand [ms].
    st.sampled_from((9, 9, 9, 9, 0, 1, 17, 99, 101, 150, 700)),
    st.sampled_from(SIDES),
    st.sampled_from((0.0, 0.01, 0.4)),
)
# Times between frames and at them.
steps = st.lists(st.sampled_from((9, 0, 1, 4, 8, 17, 50)), min_size=20, max_size=60)


def listed(
    hand: TrackedHand, time: int, samples: Sequence[resample.Sample]
) -> tuple[resample.Sample, resample.Sample] | None:
    """The samples to interpolate between, found in a list of all times; None if not to."""
    after = int(np.searchsorted([sample.time for sample in samples], time, side="right"))
    if hand.state != "live" or not 0 < after < len(samples):
        return None
    first, second = samples[after - 1], samples[after]
    near = 0 < second.time - first.time <= 100 * MILLISECOND
    return (first, second) if near and second.hand.contact >= first.hand.contact else None


@settings(max_examples=100)
@given(st.lists(frames, min_size=10, max_size=40), steps)
def test_hands_lie_between_the_samples_that_a_full_list_gives(recorded, steps) -> None:
    """Interpolate as with a list of all times, or not, at whatever times and with any gaps."""
    interpolated = resample._interpolated

    def compared(hand: TrackedHand, time: int, samples: Sequence[resample.Sample]) -> TrackedHand:
        result, found = interpolated(hand, time, samples), listed(hand, time, samples)
        if found is None:
            assert result is hand
            return result
        first, second = found
        share = (time - first.time) / (second.time - first.time)
        moved = share * (second.hand.positions - first.hand.positions)
        assert np.array_equal(result.positions, first.hand.positions + moved)
        assert np.array_equal(result.valid, first.hand.valid & second.hand.valid)
        return result

    entries, arrivals = [], accumulate(step for step, _, _ in recorded)
    for number, (arrived, (_, side, x)) in enumerate(zip(arrivals, recorded, strict=True)):
        time = arrived * MILLISECOND
        place = (x + 1e-4 * number, 0.2, 0.0)
        entries.append(Entry(time, frame_at(time, number, side, at=place)))
    with patch.object(resample, "_interpolated", compared):
        resampled_hands(entries, [time * MILLISECOND for time in accumulate(steps)])


@pytest.mark.parametrize("count", [50, 200, 800])
def test_work_grows_with_the_length_of_a_recording(
    count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Look at a few samples for each time, not at all of them."""
    looks = 0

    class Counted(resample.Sample):
        """A sample that counts how often its time is read."""

        @property
        def time(self) -> int:
            nonlocal looks
            looks += 1
            return int(self[0])

    monkeypatch.setattr(resample, "Sample", Counted)
    times = [number * STEP for number in range(count)]
    resampled_hands(moving(count), times)
    assert 0 < looks <= 20 * count
