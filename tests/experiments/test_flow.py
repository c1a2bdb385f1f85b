# SPDX-License-Identifier: GPL-3.0-or-later
"""Simple shear and flow down an incline: what modulus and yield stress mean."""

import pytest

from tactile_clay.solver import Material
from tactile_clay.tests.experiments.couette import couette
from tactile_clay.tests.experiments.poiseuille import poiseuille


def test_shear_modulus_is_that_of_the_material():
    """Shear elastically with the material's modulus, to a fifth: the plates' layers are softer."""
    material = Material(yield_stress=5e3, shear_modulus=2.5e5)
    sheared = couette(0.2, 0.01, material=material)
    assert sheared.stress[-1] / sheared.strain[-1] == pytest.approx(2.5e5, rel=0.2)


def test_yield_stress_is_that_of_the_material():
    """Resist steady shear with the yield stress, to 30 %.

    Bonds that turned with the flow no longer pull quite along it.
    """
    rate, stress = couette(5.0, 1.0, material=Material(viscosity=20.0)).flow(0.5)
    assert stress == pytest.approx(5e3 + 20.0 * rate, rel=0.30)


def test_a_layer_below_its_yield_stress_stays():
    """Creep by less than a hundredth of its depth where the yield stress is not reached."""
    layer = poiseuille(0.4, travel=0.5)
    stiff = poiseuille(1.5, duration=0.5)
    assert stiff.speed.max() < 0.01 * layer.speed.max()
