# SPDX-License-Identifier: GPL-3.0-or-later
"""The potter's wheel: what it carries and throws off, and when a disc flows."""

import math

import pytest

from tactile_clay.tests.experiments.wheel import hang, spin_disc, turn_lump, turn_wheel


@pytest.mark.parametrize("rpm", [100.0, 300.0])
def test_wheel_carries_a_block_on_its_axis(rpm: float):
    """Turn a block with the wheel, without slipping or spreading."""
    result = turn_wheel(rpm, counts=(4, 4, 3), turns=0.5)
    assert result.turn_ratio == pytest.approx(1.0, abs=0.002)
    assert result.radius_ratio == pytest.approx(1.0, abs=0.005)
    assert result.slip < 1e-4
    assert result.weight_ratio == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(("offset", "carried"), [(0.0415, True), (0.048, False)])
def test_friction_limits_the_radius_that_a_wheel_carries(offset: float, carried: bool):
    """Carry a block within the radius μ g / ω², 44.7 mm, and throw it off beyond, within 8 %."""
    result = turn_wheel(100.0, offset=offset, counts=(4, 4, 2), turns=1.0)
    assert (result.grip > 1.0) == carried
    assert (result.slip < 1e-3) == carried
    assert (result.slip > 0.02) == (not carried)


@pytest.mark.parametrize("friction", [0.2, 0.8])
def test_friction_decides_what_is_thrown_off(friction: float):
    """Carry a block at 0.97 times the radius μ g / ω², and lose it at 1.03 times, for two μ."""
    limit = friction * 9.81 / (100.0 * 2 * math.pi / 60) ** 2
    held = turn_wheel(offset=0.97 * limit, counts=(4, 4, 2), turns=1.0, friction=friction)
    lost = turn_wheel(offset=1.03 * limit, counts=(4, 4, 2), turns=1.0, friction=friction)
    assert held.slip < 1e-5
    assert lost.slip > 5e-3


def test_lump_of_the_paper_turns_at_100_rpm():
    """Keep 4,169 particles in place on the wheel, with one substep more than at rest."""
    result = turn_lump(100.0)
    assert result.particle_count == 4169
    assert result.angle_error < 1e-6
    assert result.momentum_ratio == pytest.approx(1.0, abs=0.001)
    assert result.radius_ratio == pytest.approx(1.0, abs=5e-4)
    assert (result.substeps, result.jumps) == (5, 0)


def test_wheel_turns_through_a_long_step():
    """Carry clay through 120 degrees in one step, as a slow live session may require."""
    result = turn_lump(300.0, particle_count=400, step=4 / 60)
    assert result.angle_error < 1e-6
    assert result.momentum_ratio == pytest.approx(1.0, abs=0.001)
    assert result.jumps == 0


def test_substeps_do_not_grow_with_the_wheel():
    """Need no more substeps on a wheel three times as large."""
    small = turn_lump(100.0, particle_count=400, turns=0.1)
    large = turn_lump(100.0, particle_count=400, turns=0.1, wheel_radius=0.39)
    assert small.substeps == large.substeps
    assert large.jumps == 0


@pytest.mark.parametrize(("adhesion", "holds"), [(0.0, False), (250.0, False), (600.0, True)])
def test_clay_sticks_to_an_adhesive_plate(adhesion: float, holds: bool):
    """Hold a block of ρ g h = 334 Pa upside down if the adhesion exceeds that, else drop it."""
    fallen = hang(adhesion)
    assert fallen < 0.01 if holds else fallen > 0.1


def test_disc_holds_below_the_plastic_limit():
    """Keep radius and momentum at 300 rpm, below the theoretical limit of 373."""
    result = spin_disc(300.0, radius=0.1, spacing=0.01)
    assert result.radius_ratio < 1.05
    assert result.spin_kept == pytest.approx(1.0, abs=1e-4)


def test_disc_spreads_beyond_the_plastic_limit():
    """Flow outward by at least a tenth at 450 rpm."""
    assert spin_disc(450.0, radius=0.1, spacing=0.01, duration=0.5).radius_ratio > 1.1


def test_small_soft_disc_holds_below_the_plastic_limit():
    """Keep the radius of a 30 mm disc at 300 rpm."""
    assert spin_disc(300.0).radius_ratio < 1.05
