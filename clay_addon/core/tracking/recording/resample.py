# SPDX-License-Identifier: GPL-3.0-or-later
"""A recording as it is at given times: the same hands that live tracking would have shown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .....solver.geometry.rotations import slerp
from ..hand.hand_tracker import HandTracker
from ..hand.presence import TrackedHand
from ..protocol.joints import SIDES
from .recording import Entry

_WIDEST_GAP = 100_000_000
"""Between two frames further apart than this nothing is interpolated [ns]."""


class Moment(NamedTuple):
    """A hand at the moment that a frame of it was seen."""

    time: int
    """When [ns]."""
    hand: TrackedHand
    """The hand, filtered."""


def resampled_hands(
    entries: Sequence[Entry], times: Sequence[int]
) -> dict[str, list[TrackedHand | None]]:
    """Both hands at each of some times.

    Frames go through the same rules and filters as in live tracking, so that what was lost there is
    lost here. Between two frames the hand is interpolated, so that the tracker's own pace does not
    show in the animation.

    Args:
        entries: The recording, in the order of its times.
        times: Since its start, ascending [ns].

    Returns:
        For each side, the hand at each time; None before it was first seen.
    """
    tracker = HandTracker()
    moments: dict[str, list[Moment]] = {side: [] for side in SIDES}
    sampled: dict[str, list[TrackedHand | None]] = {side: [] for side in SIDES}
    number = 0
    for time in times:
        while number < len(entries) and entries[number].time <= time:
            _take(tracker, entries[number], moments)
            number += 1
        for side in SIDES:
            sampled[side].append(tracker.hand(side, time))
    for entry in entries[number:]:
        _take(tracker, entry, moments)
    return {
        side: [
            hand if hand is None else _interpolated(hand, time, moments[side])
            for hand, time in zip(sampled[side], times, strict=True)
        ]
        for side in SIDES
    }


def _take(tracker: HandTracker, entry: Entry, moments: dict[str, list[Moment]]) -> None:
    tracker.take(entry.frame, entry.time)
    hand = tracker.hand(entry.frame.side, entry.time)
    if hand is not None and hand.state == "live":
        moments[entry.frame.side].append(Moment(entry.time, hand))


def _interpolated(hand: TrackedHand, time: int, moments: Sequence[Moment]) -> TrackedHand:
    after = int(np.searchsorted([moment.time for moment in moments], time, side="right"))
    if hand.state != "live" or not 0 < after < len(moments):
        return hand
    first, second = moments[after - 1], moments[after]
    gap = second.time - first.time
    # Contact starts anew where the hand jumped or came back.
    if not 0 < gap <= _WIDEST_GAP or second.hand.contact < first.hand.contact:
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
