# SPDX-License-Identifier: GPL-3.0-or-later
"""Simple shear and flow down an incline have the material's modulus, yield stress and viscosity."""

import pytest

from tactile_clay.solver import Material
from tactile_clay.tests.experiments.couette import couette
from tactile_clay.tests.experiments.poiseuille import poiseuille


def test_shear_modulus_is_that_of_the_material():
    """Shear elastically with the material's modulus to a fifth; layers at the plates are softer."""
    material = Material(yield_stress=5e3, shear_modulus=2.5e5)
    sheared = couette(0.2, 0.01, material=material, squeeze=0.2, jitter=0.0)
    assert sheared.stress[-1] / sheared.strain[-1] == pytest.approx(2.5e5, rel=0.2)


def test_yield_stress_is_that_of_the_material():
    """Resist slow steady shear with the yield stress to an eighth."""
    rate, stress = couette(2.0, 2.0, material=Material(viscosity=20.0)).flow(1.0)
    assert stress == pytest.approx(5e3 + 20.0 * rate, rel=0.125)


def test_viscosity_is_that_of_the_material():
    """Resist shear at 10 /s with yield stress plus viscous stress to 15 %."""
    rate, stress = couette(10.0, 2.0, material=Material(viscosity=400.0)).flow(1.0)
    assert stress == pytest.approx(5e3 + 400.0 * rate, rel=0.15)


@pytest.mark.parametrize("yield_ratio", [0.0, 0.25])
def test_a_film_flows_as_fast_as_theory_says(yield_ratio: float):
    """Flow down an incline with a Bingham film's speed to a fifth, with ten layers."""
    assert poiseuille(yield_ratio).plug == pytest.approx(1.0, abs=0.2)


def test_a_thinning_film_flows_as_fast_as_theory_says():
    """Flow with the speed of a Herschel-Bulkley film of index 0.5 to a third, with ten layers."""
    film = poiseuille(0.25, viscosity=400.0, flow_index=0.5)
    assert film.plug == pytest.approx(1.0, abs=0.33)


def test_a_layer_below_its_yield_stress_stays():
    """Move at less than a hundredth of a flowing layer's speed below the yield stress."""
    layer = poiseuille(0.4, travel=0.5)
    stiff = poiseuille(1.5, duration=0.5)
    assert stiff.speed.max() < 0.01 * layer.speed.max()
