# SPDX-License-Identifier: GPL-3.0-or-later
"""The potter's wheel: what it carries, what it throws off, and when a disc flows."""

import pytest

from tactile_clay.tests.experiments.wheel import spin_disc, turn_wheel


@pytest.mark.parametrize("rpm", [100.0, 300.0])
def test_wheel_carries_a_block_on_its_axis(rpm: float):
    """Turn a block with the wheel, without slip and without spreading it."""
    result = turn_wheel(rpm, counts=(4, 4, 3), turns=0.5)
    assert result.turn_ratio == pytest.approx(1.0, abs=0.002)
    assert result.radius_ratio == pytest.approx(1.0, abs=0.005)
    assert result.slip < 1e-4
    assert result.weight_ratio == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(("offset", "carried"), [(0.0415, True), (0.048, False)])
def test_friction_limits_the_radius_that_a_wheel_carries(offset: float, carried: bool):
    """Hold where ω² r < μ g, at 44.7 mm, and throw off where it is more, within 8 %."""
    result = turn_wheel(100.0, offset=offset, counts=(4, 4, 2), turns=1.0)
    assert (result.grip > 1.0) == carried
    assert (result.slip < 1e-3) == carried
    assert (result.slip > 0.02) == (not carried)


def test_disc_holds_below_the_plastic_limit():
    """Keep radius and momentum at 300 rpm where theory puts the limit at 373."""
    result = spin_disc(300.0, radius=0.1, spacing=0.01)
    assert result.radius_ratio < 1.05
    assert result.spin_kept == pytest.approx(1.0, abs=1e-4)


def test_disc_spreads_beyond_the_plastic_limit():
    """Flow outward at 450 rpm, by a tenth at least."""
    assert spin_disc(450.0, radius=0.1, spacing=0.01, duration=0.5).radius_ratio > 1.1


def test_small_soft_disc_holds_below_the_plastic_limit():
    """Keep the radius of a disc of 30 mm at 300 rpm."""
    assert spin_disc(300.0).radius_ratio < 1.05
