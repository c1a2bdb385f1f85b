# SPDX-License-Identifier: GPL-3.0-or-later
"""Free fall and momentum against their exact values."""

import pytest

from tactile_clay.tests.experiments import falling, motion


def test_free_fall_is_exact():
    """Fall ½ g t², without any distortion."""
    result = falling.free_fall()
    assert result.fallen == pytest.approx(result.expected, rel=1e-5)
    assert result.distortion < 1e-6


def test_free_spin_keeps_momentum_and_shape():
    """Conserve linear momentum to 1e-5, angular momentum to 1e-4 per step, and the shape."""
    result = motion.spin()
    assert result.momentum < 1e-5
    assert result.spin_change_per_step < 1e-4
    assert result.spin_kept == pytest.approx(1.0, abs=0.01)
    assert result.radius_ratio == pytest.approx(1.0, abs=0.01)


def test_collision_of_different_densities_keeps_momentum():
    """Conserve linear and angular momentum when two blocks meet off-center."""
    result = motion.collision()
    assert result.momentum_change < 1e-5
    assert result.momentum_change_per_step < 1e-5
    assert result.spin_change < 1e-4
    assert result.spin_change_per_step < 1e-4


def test_table_stops_a_fall_with_the_right_impulse():
    """Exert an impulse of m g t over fall, landing and rest, and keep the block's height."""
    result = falling.drop()
    assert result.impulse_ratio == pytest.approx(1.0, abs=0.02)
    assert result.height_ratio == pytest.approx(1.0, abs=0.03)
