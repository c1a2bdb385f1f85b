# SPDX-License-Identifier: GPL-3.0-or-later
"""The contact sheet of a recording."""

from pathlib import Path

import numpy as np

from tactile_clay.clay_addon.core.tracking.hand.hand_tracker import HandTracker
from tactile_clay.clay_addon.core.tracking.recording.recording import Recorder
from tactile_clay.tests.clay_addon.core.tracking.hands import MILLISECOND, frame_at, shown
from tactile_clay.tests.experiments.tracked_hands_picture import (
    contact_sheet,
    hand_triangles,
    reference_target,
    round_cone,
)


def test_bones_are_as_thick_as_the_hand() -> None:
    """Draw bones with their radius, and a hand of realistic size."""
    bone = round_cone(np.zeros(3), np.array([0.0, 0.1, 0.0]), 0.01, 0.005).reshape(-1, 3)
    assert np.allclose([bone.min(0), bone.max(0)], [[-0.01] * 3, [0.01, 0.105, 0.01]], atol=6e-4)
    tracker = HandTracker()
    tracker.take(frame_at(1), 1)
    hand = shown(tracker.hand("right", 1))
    triangles = hand_triangles(reference_target("right"), hand)
    assert 0.19 < np.ptp(triangles.reshape(-1, 3), axis=0).max() < 0.24


def test_sheet_is_drawn(tmp_path: Path) -> None:
    """Draw a recording of two hands, one of which disappears."""
    recorder = Recorder(tmp_path / "take.jsonl")
    for number in range(60):
        for side, x in (("left", -0.15), ("right", 0.15)):
            if side == "right" or number < 20:
                at = (x + 1e-4 * number, 0.2, 0.0)
                recorder.take(frame_at(number, number, side, at), number * 20 * MILLISECOND)
    recorder.close()
    contact_sheet(tmp_path / "take.jsonl", tmp_path / "sheet.png")
    assert (tmp_path / "sheet.png").stat().st_size > 20_000
