# SPDX-License-Identifier: GPL-3.0-or-later
"""Which datagrams are accepted as new."""

from hypothesis import given
from hypothesis import strategies as st

from tactile_clay.clay_addon.core.tracking.protocol.frame_order import FrameOrder
from tactile_clay.tests.clay_addon.core.tracking.hands import MILLISECOND, frame_at

START = 1000 * MILLISECOND


def feed(order: FrameOrder, *frames: tuple[int, int, int], sender: str = "one") -> list[bool]:
    """Feed frames (sequence, source time [ms], arrival [ms]); whether each is accepted."""
    return [
        order.accept(frame_at(time * MILLISECOND, number), sender, arrival * MILLISECOND)
        is not None
        for number, time, arrival in frames
    ]


def test_old_and_duplicate_frames_are_dropped() -> None:
    """Drop frames that were overtaken or arrive twice."""
    order = FrameOrder()
    frames = [(1, 10, 110), (3, 30, 130), (2, 20, 131), (3, 30, 132), (4, 40, 140)]
    assert feed(order, *frames) == [True, True, False, False, True]


def test_sequence_wraps() -> None:
    """Continue past 2^32."""
    order = FrameOrder()
    last = 2**32 - 1
    frames = [(last - 1, 10, 110), (last, 20, 120), (0, 30, 130), (last, 20, 131), (1, 40, 140)]
    assert feed(order, *frames) == [True, True, True, False, True]


def test_restarted_sender_is_recognized_at_once() -> None:
    """Accept a sequence that restarts while the clock continues."""
    order = FrameOrder()
    frames = [(500, 10, 110), (1, 900, 1000), (2, 910, 1010)]
    assert feed(order, *frames) == [True, True, True]


def test_sender_restarted_on_a_clock_set_back_needs_silence_and_a_run() -> None:
    """Accept frames that look old only after silence, and only several in a row."""
    order = FrameOrder()
    assert feed(order, (500, 5000, 110)) == [True]
    soon = [(number, 10 * number, 120 + number) for number in range(1, 8)]
    assert not any(feed(order, *soon))
    later = [(number, 10 * number, 400 + 10 * number) for number in range(1, 8)]
    assert feed(order, *later) == [False] * 4 + [True] * 3


def test_straggler_after_silence_is_no_restart() -> None:
    """Drop single old frames, however late, so that no stale hand is shown."""
    order = FrameOrder()
    assert feed(order, (500, 5000, 110)) == [True]
    stragglers = [(498, 4980, 1000), (490, 4900, 2000), (499, 4990, 3000), (480, 4800, 4000)]
    assert not any(feed(order, *stragglers))


def test_second_sender_is_accepted_when_the_first_is_silent() -> None:
    """Accept one sender at a time."""
    order = FrameOrder()
    assert feed(order, (1, 10, 110)) == [True]
    assert feed(order, (70, 20, 120), (71, 30, 200), sender="two") == [False, False]
    assert feed(order, (72, 40, 500), sender="two") == [True]
    assert feed(order, (2, 20, 510)) == [False]


def test_age_of_late_frames_is_known() -> None:
    """Return the true time of a frame that a stalled receiver finds later."""
    order = FrameOrder()
    for number in range(10):
        order.accept(frame_at(number * MILLISECOND, number), "one", START + number * MILLISECOND)
    late = order.accept(frame_at(20 * MILLISECOND, 20), "one", START + 3000 * MILLISECOND)
    assert late == START + 20 * MILLISECOND


def test_drifting_clock_does_not_age_a_hand() -> None:
    """Forget the smallest delay of long ago."""
    order = FrameOrder()
    seen = 0
    for number in range(3000):
        arrival = START + number * 10 * MILLISECOND
        # A clock that is slow by 0.1 % falls 30 ms behind in half a minute.
        time = round(number * 10 * MILLISECOND * 0.999)
        seen = order.accept(frame_at(time, number), "one", arrival) or 0
    assert arrival - seen < 11 * MILLISECOND


@given(st.permutations(range(30)))
def test_accepted_frames_are_ascending(order_of_arrival: list[int]) -> None:
    """Accept only ascending frames, each once, and always the newest."""
    order = FrameOrder()
    kept = [
        number
        for place, number in enumerate(order_of_arrival + order_of_arrival)
        if order.accept(frame_at(number * MILLISECOND, number), "one", START + place) is not None
    ]
    assert kept == sorted(set(kept))
    assert kept[-1] == 29
