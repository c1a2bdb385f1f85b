# SPDX-License-Identifier: GPL-3.0-or-later
"""The person's own hand, measured from frames."""

from pathlib import Path

import numpy as np
import pytest

from tactile_clay.clay_addon.core.tracking import TrackingError
from tactile_clay.clay_addon.core.tracking.formats.leap import read_leap_file
from tactile_clay.clay_addon.core.tracking.hand.measured_hand import measured_hand
from tactile_clay.clay_addon.core.tracking.protocol.joints import (
    FINGERS,
    PALM,
    PARENTS,
    reference_hand,
)
from tactile_clay.clay_addon.core.tracking.protocol.packet import HandFrame
from tactile_clay.tests.clay_addon.core.tracking.hands import flat_hand

TURN = np.array([0.3, -0.5, 0.2, 0.787])
TURN = TURN / np.linalg.norm(TURN)
TIPS = [finger[-1] for finger in FINGERS]


def frames(size: float, *, count: int = 20, side: str = "right", **options) -> list[HandFrame]:
    """Frames of a hand of some size, moving."""
    return [
        HandFrame(
            side=side,
            source_time=number,
            joints=flat_hand(side, (0.01 * number, 0.2, 0.0), quaternion=TURN, size=size),
            **options,
        )
        for number in range(count)
    ]


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("size", [0.75, 1.2])
def test_hand_is_as_large_as_the_persons(size: float, side: str) -> None:
    """Scale joints and radii with the person's; tips lie a radius inside of the tracker's."""
    positions, radii = measured_hand(frames(size, side=side))
    reference = reference_hand(side)
    assert np.allclose(radii, size * reference.radii, rtol=1e-4)
    inner = [joint for joint in range(26) if joint not in TIPS]
    assert np.allclose(positions[inner], size * reference.positions[inner], atol=1e-5)
    for tip in TIPS:
        bone = reference.positions[tip] - reference.positions[PARENTS[tip]]
        way = size * np.linalg.norm(bone)
        inset = min(size * reference.radii[tip], 0.5 * way)
        length = np.linalg.norm(positions[tip] - positions[PARENTS[tip]])
        assert length == pytest.approx(way - inset, rel=1e-3)


def test_wrong_frames_do_not_matter() -> None:
    """Measure the same where a third of the frames is of a giant's hand, or doubtful."""
    good, _ = measured_hand(frames(1.0))
    mixed, _ = measured_hand(frames(3.0, count=9) + frames(1.0) + frames(5.0, confidence=0.1))
    assert np.allclose(good, mixed, atol=1e-6)


def test_tracker_without_radii_gets_those_of_its_size() -> None:
    """Take the reference hand's radii, scaled, where the tracker gives none."""
    seen = frames(1.1)
    for frame in seen:
        frame.joints[:, 7] = 0.0
    _, radii = measured_hand(seen)
    assert np.allclose(radii, 1.1 * reference_hand("right").radii, rtol=1e-3)


def test_too_few_frames_are_refused() -> None:
    """Ask for more when the hand was hardly seen."""
    with pytest.raises(TrackingError, match="seen well in 9 frames"):
        measured_hand(frames(1.0, count=9))


def test_real_hands_are_of_human_proportions(leap_recording: Path) -> None:
    """Measure recorded hands: bones within a factor of 1.5 of the average, fingers in order."""
    hands = [hand for _, hands in read_leap_file(leap_recording) for hand in hands]
    positions, radii = measured_hand(hands)
    assert np.isfinite(positions).all()
    reference = reference_hand("right")
    for joint, parent in enumerate(PARENTS):
        if parent < 0 or joint == PALM:
            continue
        usual = np.linalg.norm(reference.positions[joint] - reference.positions[parent])
        length = np.linalg.norm(positions[joint] - positions[parent])
        assert usual / 1.6 < length < 1.6 * usual
    assert 0.15 < -positions[15, 2] < 0.22
    assert np.all((radii > 0.004) & (radii < 0.025))
