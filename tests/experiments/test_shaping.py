# SPDX-License-Identifier: GPL-3.0-or-later
"""Dents, slumps and merging, the defining behavior of clay."""

import pytest

from tactile_clay.solver import Material, Settings
from tactile_clay.tests.experiments.merge import merge
from tactile_clay.tests.experiments.press import Press, press
from tactile_clay.tests.experiments.slump import slump


@pytest.fixture(scope="module")
def pressed() -> Press:
    """A pressed block, shared by the tests."""
    return press()


def test_dent_stays(pressed: Press):
    """Keep most of a 12 mm dent."""
    assert pressed.dent_pressed > 0.010
    assert pressed.spring_back < 0.15


def test_press_force_is_that_of_plastic_clay(pressed: Press):
    """Push back with the force of slip-line theory to some 25 %."""
    low, high = pressed.theory
    assert 0.75 * low < pressed.force_moving - pressed.viscous < 1.3 * high
    assert 0.75 * low < pressed.force_held < 1.25 * high


def test_volume_recovers_after_a_press(pressed: Press):
    """Compress by less than 3 % during a press and by less than 1 % afterwards."""
    assert pressed.compression_pressed < 0.03
    assert pressed.compression_left < 0.01


def test_nothing_enters_the_tool(pressed: Press):
    """Keep penetration into the sphere below a tenth of a spacing at 15 N."""
    assert pressed.max_penetration < 0.1 * 0.005


def test_force_grows_with_yield_stress():
    """Push back twice as hard at twice the yield stress, within a quarter."""
    soft = press(0.006, material=Material(yield_stress=1e3, viscosity=5.0, shear_modulus=5e4))
    firm = press(0.006, material=Material(yield_stress=2e3, viscosity=5.0, shear_modulus=1e5))
    assert firm.force_held / soft.force_held == pytest.approx(2.0, rel=0.25)


def test_viscosity_resists_a_fast_press():
    """Push back harder on a moving ball with viscosity than without."""
    thick = Material(yield_stress=1e3, viscosity=500.0)
    viscous = press(0.006, material=thick)
    ideal = press(0.006, material=thick, settings=Settings(viscosity=False))
    assert viscous.force_moving > 1.5 * ideal.force_moving


@pytest.mark.parametrize("yield_ratio", [0.1, 0.2, 0.3])
def test_slump_follows_theory(yield_ratio: float):
    """Slump as predicted by Pashias and von Mises, within 15 % of the height."""
    result = slump(yield_ratio)
    low, high = result.pashias - 0.15, result.von_mises + 0.15
    assert low < result.measured < high


def test_softer_clay_slumps_more():
    """Slump less with increasing yield stress; a stiff cylinder stands."""
    depths = [slump(ratio).measured for ratio in (0.1, 0.2, 0.3, 0.7)]
    assert depths == sorted(depths, reverse=True)
    assert depths[-1] < 0.03


def test_without_bonds_clay_flows_flat():
    """Flow flat when elastoplasticity is turned off."""
    result = slump(0.7, settings=Settings(elastoplasticity=False))
    assert result.measured > 0.3


def test_blocks_pressed_together_lift_as_one():
    """Lift the lower block with the upper one after a press of 5 mm."""
    result = merge()
    assert result.upper > 0.9 * result.lift
    assert result.lower > 0.8 * result.lift


def test_without_cohesion_nothing_sticks():
    """Leave the lower block on the table if the clay has no tensile strength."""
    result = merge(material=Material(cohesion=0.0))
    assert result.lower < 0.1 * result.lift
