# SPDX-License-Identifier: GPL-3.0-or-later
"""Coulomb friction against textbook values."""

import math

import pytest

from tactile_clay.tests.experiments.coulomb import creep, drag, stop


@pytest.mark.parametrize("friction", [0.2, 0.5])
def test_dragged_block_rubs_with_mu_times_its_weight(friction: float):
    """Exert μ m g on the table and the paddle within 2 %, steadily."""
    result = drag(friction=friction, duration=0.5)
    assert result.table_ratio == pytest.approx(1.0, abs=0.02)
    assert result.paddle_ratio == pytest.approx(1.0, abs=0.02)
    assert result.unsteadiness < 0.05


@pytest.mark.parametrize(("speed", "friction"), [(0.5, 0.5), (1.0, 0.5), (0.5, 0.2)])
def test_sliding_block_stops_after_v_squared_over_two_mu_g(speed: float, friction: float):
    """Stop within 3 % of v² / 2 μ g, and stay."""
    result = stop(speed, friction=friction)
    assert result.distance == pytest.approx(result.expected, rel=0.03)
    assert result.speed_after < 1e-4


@pytest.mark.parametrize("degrees", [15.0, 25.0])
def test_sticking_block_creeps_less_than_a_millimeter_a_minute(degrees: float):
    """Stick on an incline below arctan μ, 26.6°."""
    assert creep(math.radians(degrees), friction=0.5, duration=1.0) < 1e-3 / 60
