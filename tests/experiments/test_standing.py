# SPDX-License-Identifier: GPL-3.0-or-later
"""Weight, sticking and sliding of a block."""

import math

import pytest

from tactile_clay.solver import Settings
from tactile_clay.tests.experiments.standing import GRAVITY, stand


def test_block_at_rest_weighs_m_g_and_stays():
    """Weigh m g within 1 % and drift less than a hundredth of a spacing in two seconds."""
    result = stand(duration=2.5)
    assert result.normal_force == pytest.approx(1.0, abs=0.01)
    assert result.drift < 0.01 * 0.005
    assert result.kinetic_energy < 1e-8


def test_block_holds_on_a_gentle_incline():
    """Stay put if tan θ < μ, and exert m g cos θ and m g sin θ on the plane within 2 %."""
    angle = math.radians(15)
    result = stand(angle, friction=0.6)
    assert result.normal_force == pytest.approx(math.cos(angle), rel=0.02)
    assert result.tangential_force == pytest.approx(math.sin(angle), rel=0.02)
    assert abs(result.slip) < 5e-4


def test_block_slides_on_a_steep_incline():
    """Slide with g (sin θ - μ cos θ) within 3 % if tan θ > μ."""
    angle, friction = math.radians(35), 0.6
    expected = GRAVITY * (math.sin(angle) - friction * math.cos(angle))
    assert stand(angle, friction=friction).acceleration == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize(("degrees", "slips"), [(25.57, False), (27.57, True)])
def test_friction_brackets_the_critical_angle(degrees: float, slips: bool):
    """Stick one degree below arctan μ, and slip one degree above."""
    result = stand(math.radians(degrees), friction=0.5, duration=1.5)
    assert (result.slip > 2e-3) == slips


def test_without_friction_everything_slides():
    """Slide with g sin θ when friction is turned off."""
    angle = math.radians(10)
    result = stand(angle, settings=Settings(friction=False))
    assert result.acceleration == pytest.approx(GRAVITY * math.sin(angle), rel=0.01)
    assert abs(result.tangential_force) < 1e-6
