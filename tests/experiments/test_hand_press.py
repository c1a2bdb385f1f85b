# SPDX-License-Identifier: GPL-3.0-or-later
"""The force of a pressed finger depends on stiffness, not on lattice or substeps."""

import pytest

from tactile_clay.solver import Material, Settings
from tactile_clay.tests.experiments.hand_cost import measure_cost
from tactile_clay.tests.experiments.hand_press import press_clay, press_flat
from tactile_clay.tests.experiments.hand_shapes import finger
from tactile_clay.tests.experiments.shapes import at

CONVERGED = {0.002: 1.142, 0.003: 2.795}
"""Force [N] by depth [m] on a lattice of 3 mm; 4 mm gives 1.21 and 2.91."""


@pytest.mark.parametrize("depth", list(CONVERGED))
@pytest.mark.parametrize("edge", [0.008, 0.006])
def test_a_flat_press_does_not_depend_on_the_lattice(edge: float, depth: float):
    """Agree with a fine lattice to a tenth, with two or three cells across the finger."""
    force = press_flat(depth, edge=edge, iterations=20, rounds=120)
    assert force == pytest.approx(CONVERGED[depth], rel=0.105)


def test_a_flat_press_is_as_stiff_as_the_flesh():
    """Double the force with Young's modulus, unaffected by bones and iterations."""
    soft, stiff = (press_flat(0.002, young_modulus=e, rounds=120) for e in (2e4, 4e4))
    assert stiff == pytest.approx(2.0 * soft, rel=0.01)


def test_a_press_into_stiff_clay_grows_with_the_stiffness_of_flesh():
    """Exert more force with stiffer flesh, and go deeper into the clay."""
    material = Material(yield_stress=2e4, shear_modulus=5e5)
    presses = [press_clay(0.006, young_modulus=e, material=material) for e in (2e4, 1e5, 1e6)]
    forces = [press.force_moving for press in presses]
    depths = [press.tip_depth for press in presses]
    assert forces[0] < 0.8 * forces[1] < 0.8 * forces[2]
    assert depths[0] < depths[1] < depths[2] < 0.0061


@pytest.mark.parametrize(("edge", "substeps"), [(0.008, 2), (0.006, 8)])
def test_a_press_into_clay_does_not_depend_on_substeps_or_lattice(edge: float, substeps: int):
    """Measure the same force to 10 %, and a steady one."""
    reference = press_clay()
    other = press_clay(rig=finger(edge), settings=Settings(substeps=substeps))
    assert other.force_moving == pytest.approx(reference.force_moving, rel=0.10)
    assert other.unsteadiness < 0.02


def test_cost_of_a_hand_is_measured():
    """Count the parts of a hand, and measure its share of the frame."""
    cost = measure_cost(finger(0.01), at(0, 0, 0.0405), travel=0.004, frames=6)
    assert cost.tetrahedra > cost.nodes > 50
    assert cost.contacts > 0
    assert 0.0 < cost.hand < cost.frame
