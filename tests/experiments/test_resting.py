# SPDX-License-Identifier: GPL-3.0-or-later
"""Undisturbed clay does not change."""

import pytest

from tactile_clay.tests.experiments.resting import Rest, rest


@pytest.fixture(scope="module")
def rested() -> Rest:
    """A rested block, shared by the tests; the report's rests far longer."""
    return rest(600, counts=4)


def test_block_at_rest_does_not_drift(rested: Rest):
    """Move less than a hundredth of a spacing in six hundred steps."""
    assert rested.drift < 0.01


def test_energy_of_rest_does_not_grow(rested: Rest):
    """End with no more kinetic energy than at the start, and hardly any."""
    assert rested.energy_late < max(2.0 * rested.energy_early, 1e-10)
    assert rested.energy_late < 1e-8


def test_block_at_rest_keeps_its_volume(rested: Rest):
    """Change compression and height by less than 1 %."""
    assert abs(rested.volume_change) < 0.01
    assert abs(rested.height_change) < 0.01


def test_block_at_rest_keeps_its_weight(rested: Rest):
    """Weigh m g within 1 % at all times."""
    assert rested.weight_ratios == pytest.approx((1.0, 1.0), abs=0.01)
