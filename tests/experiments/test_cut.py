# SPDX-License-Identifier: GPL-3.0-or-later
"""Merged blocks are split again by a knife."""

import pytest

from tactile_clay.tests.experiments.cut import cut


def test_a_knife_splits_merged_blocks():
    """Merge two blocks into one piece, and cut it into two separate equal halves."""
    result = cut()
    assert result.pieces_before == 1
    assert result.pieces_after == 2
    assert result.debris == 0
    assert result.evenness > 0.9
    assert result.gap > 0.9 * result.push
    assert abs(result.pulled_along) < 0.05 * result.push


@pytest.mark.parametrize("thickness", [0.5, 0.3])
def test_a_thin_knife_splits_too(thickness: float):
    """Split with a blade half or a third of a spacing thick."""
    result = cut(thickness=thickness)
    assert result.pieces_after == 2
    assert result.debris == 0
