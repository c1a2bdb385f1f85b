# SPDX-License-Identifier: GPL-3.0-or-later
"""Resamples a recording at given times, as live tracking would have shown it."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from .....solver.geometry.rotations import slerp
from ..hand.hand_tracker import HandTracker
from ..hand.presence import TrackedHand
from ..protocol.joints import SIDES
from .recording import Entry

_MAX_GAP = 100_000_000
"""Frames farther apart than this are not interpolated [ns]."""


class Sample(NamedTuple):
    """A hand at the time of one of its frames."""

    time: int
    """[ns]"""
    hand: TrackedHand
    """The filtered hand."""


def resampled_hands(
    entries: Sequence[Entry], times: Sequence[int]
) -> dict[str, list[TrackedHand | None]]:
    """Compute both hands at given times.

    Frames pass through the same rules and filters as in live tracking, so that a hand is lost at
    the same times. Hands are interpolated between frames, so that the tracker's frame rate does not
    show in the animation.

    Args:
        entries: The recording, sorted by time.
        times: Ascending times from its start [ns].

    Returns:
        For each side, the hand at each time; None before it is first seen.
    """
    tracker = HandTracker()
    samples: dict[str, list[Sample]] = {side: [] for side in SIDES}
    hands: dict[str, list[TrackedHand | None]] = {side: [] for side in SIDES}
    index = 0
    for time in times:
        while index < len(entries) and entries[index].time <= time:
            _take(tracker, entries[index], samples)
            index += 1
        for side in SIDES:
            hands[side].append(tracker.hand(side, time))
    for entry in entries[index:]:
        _take(tracker, entry, samples)
    return {
        side: [
            hand if hand is None else _interpolated(hand, time, samples[side])
            for hand, time in zip(hands[side], times, strict=True)
        ]
        for side in SIDES
    }


def _take(tracker: HandTracker, entry: Entry, samples: dict[str, list[Sample]]) -> None:
    tracker.take(entry.frame, entry.time)
    hand = tracker.hand(entry.frame.side, entry.time)
    if hand is not None and hand.state == "live":
        samples[entry.frame.side].append(Sample(entry.time, hand))


def _interpolated(hand: TrackedHand, time: int, samples: Sequence[Sample]) -> TrackedHand:
    after = bisect_right(samples, time, key=attrgetter("time"))
    if hand.state != "live" or not 0 < after < len(samples):
        return hand
    first, second = samples[after - 1], samples[after]
    gap = second.time - first.time
    # Contact drops when the hand jumped or reappeared.
    if not 0 < gap <= _MAX_GAP or second.hand.contact < first.hand.contact:
        return hand
    share = (time - first.time) / gap
    positions = first.hand.positions + share * (second.hand.positions - first.hand.positions)
    quaternions = slerp(
        first.hand.quaternions, second.hand.quaternions, np.full(len(positions), share)
    )
    return hand._replace(
        positions=positions,
        quaternions=quaternions,
        valid=first.hand.valid & second.hand.valid,
    )
