# SPDX-License-Identifier: GPL-3.0-or-later
"""Kneading, flattening and hanging, against plasticity theory."""

import pytest

from tactile_clay.solver import Material
from tactile_clay.tests.experiments.compression import compress_cylinder
from tactile_clay.tests.experiments.shapes import block
from tactile_clay.tests.experiments.squeeze import Squeeze, squeeze, surface_volume
from tactile_clay.tests.experiments.thread import hang


@pytest.fixture(scope="module")
def squeezed() -> Squeeze:
    """A block after thirty squeezes, shared by the tests; the report makes a hundred."""
    return squeeze(30)


def test_surface_volume_is_that_of_the_particles():
    """Measure the volume of a cube within 3 %, and a proportional one when stretched."""
    cube = surface_volume(block(8, 0.005), 0.005)
    assert cube == pytest.approx(0.04**3, rel=0.03)
    assert surface_volume(block(8, 0.005) * (1.1, 1.0, 1.0), 0.005) == pytest.approx(
        1.1 * cube, rel=0.02
    )


def test_squeezes_deform_the_block_without_breaking_it(squeezed: Squeeze):
    """Shorten the block each time, and keep it in one piece."""
    assert squeezed.shortening > 0.1
    assert squeezed.pieces == 1


def test_clay_is_not_left_compressed(squeezed: Squeeze):
    """Change the compression by less than 1 %."""
    assert abs(squeezed.compression_change) < 0.01


def test_squeezes_keep_the_volume_inside_the_surface(squeezed: Squeeze):
    """Keep the volume inside the surface within 6 %, since 216 particles are mostly surface."""
    assert abs(squeezed.surface_change) < 0.06


def test_compressed_cylinder_resists_with_its_yield_stress():
    """Push back with √3 τ_y A between smooth plates, within a fifth."""
    assert compress_cylinder().ratio == pytest.approx(1.0, abs=0.2)


def test_sticking_plates_take_more_force():
    """Push back harder if the plates hold the clay, within 25 % of theory."""
    result = compress_cylinder(sticking=True)
    assert result.force > compress_cylinder().force
    assert result.ratio == pytest.approx(1.0, abs=0.25)


def test_short_thread_hangs():
    """Hold nearly unstretched at two fifths of the length √3 τ_y / ρ g."""
    result = hang(0.4)
    assert result.piece_count == 1
    assert result.stretch < 0.05


def test_long_thread_draws_out():
    """Draw out beyond that length, at a rate limited by viscosity."""
    fluid = Material(viscosity=20.0)
    assert hang(1.3, duration=0.5, material=fluid).stretch > 0.3


def test_thread_hangs_up_to_the_limit():
    """Hold at nine tenths of that length."""
    assert hang(0.9).stretch < 0.1
