# SPDX-License-Identifier: GPL-3.0-or-later
"""Gestures of soft fingers shape clay like real ones."""

import pytest

from tactile_clay.tests.experiments.hand_gestures import dent, pinch
from tactile_clay.tests.experiments.hand_shapes import finger


def test_a_pinch_tears_a_piece_off():
    """Lift the clay between the fingers, and leave the slab on the table."""
    result = pinch()
    assert result.pieces == 2
    assert 8 <= result.lifted <= 60
    assert result.grip > 1.0
    assert result.imbalance < 0.03


@pytest.mark.parametrize("radius", [0.006, 0.009])
def test_a_dent_is_as_wide_as_the_finger(radius: float):
    """Leave a dent whose width at half its depth matches the finger's to a fifth."""
    depth = 0.009
    result = dent(depth, rig=finger(0.008, radius=radius))
    expected = 2.0 * (radius**2 - (radius - 0.5 * depth) ** 2) ** 0.5
    assert result.width == pytest.approx(expected, rel=0.2)
    assert result.depth > 0.004
