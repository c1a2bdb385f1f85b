# SPDX-License-Identifier: GPL-3.0-or-later
"""The formulas of the clay's law, and that they are written only once."""

import re
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from numpy.typing import NDArray

from tactile_clay.solver import Material, Settings
from tactile_clay.solver.plastic_bonds import law, law_data
from tactile_clay.solver.plastic_bonds import law_functions as formulas
from tactile_clay.solver.plastic_bonds.law_data import ParticleLaw, SharedLaw
from tactile_clay.solver.plastic_bonds.pairs import forces_cpu, measures_cpu, products_cpu

SPACING = 0.005
STEP = 1 / 240
BONDS = Path(law.__file__).parent


@wp.kernel(enable_backward=False)
def tabulate_kernel(
    shared: SharedLaw,
    distance: wp.array[float],
    value: wp.array[float],
    slope: wp.array[float],
    hold: wp.array[float],
) -> None:
    """Tabulate the functions of distance."""
    i = wp.tid()
    value[i] = formulas.kernel_value(shared, distance[i])
    slope[i] = formulas.kernel_slope(shared, distance[i])
    hold[i] = formulas.bond_hold(shared, distance[i])


@wp.kernel(enable_backward=False)
def share_of_stretch(
    shared: SharedLaw, own: ParticleLaw, stretch: wp.array[wp.mat33], share: wp.array[float]
) -> None:
    """`flow_share` of many particles."""
    share[wp.tid()] = formulas.flow_share(shared, own, stretch[wp.tid()])


@wp.kernel(enable_backward=False)
def flow_bonds(
    shared: SharedLaw,
    tension_stretch: float,
    rest: float,
    distance: wp.array[float],
    share: float,
    bond: wp.array[wp.vec2],
) -> None:
    """`flow_bond` at many distances, for particles at constant volume."""
    i = wp.tid()
    bond[i] = formulas.flow_bond(shared, tension_stretch, rest, distance[i], 0.0, share, False)


@wp.kernel(enable_backward=False)
def damp(
    shared: SharedLaw,
    own: ParticleLaw,
    squares: float,
    rates: wp.array[float],
    damping: wp.array[float],
) -> None:
    """`pair_damping` at many shear rates."""
    i = wp.tid()
    damping[i] = formulas.pair_damping(shared, own, squares, 0.0, rates[i])


@pytest.fixture(scope="module")
def shared() -> SharedLaw:
    """The shared law at the live setting."""
    return law_data.make_shared_law(Settings(), SPACING, 1, STEP)


def particle_law(material: Material) -> ParticleLaw:
    """The law of a particle of a material."""
    return law_data.make_particle_laws([material], Settings(), SPACING)[0]


def numbers(values: NDArray) -> wp.array:
    """Single-precision numbers on the CPU."""
    return wp.array(values, dtype=float, device="cpu")


def test_slope_is_that_of_the_kernel(shared: SharedLaw):
    """Match the decrease of the density with distance."""
    distance = np.linspace(0.1, 2.4, 200) * SPACING
    value, slope, hold = (wp.zeros(len(distance), dtype=float, device="cpu") for _ in range(3))
    inputs = [shared, numbers(distance), value, slope, hold]
    wp.launch(tabulate_kernel, dim=len(distance), inputs=inputs, device="cpu")
    falls = -np.gradient(value.numpy() * shared.inverse_rest_sum, distance)
    reach = np.abs(slope.numpy()).max()
    np.testing.assert_allclose(falls[1:-1], slope.numpy()[1:-1], atol=2e-3 * reach)
    assert value.numpy()[-1] == slope.numpy()[-1] == 0.0
    assert hold.numpy()[0] == 1.0
    assert hold.numpy()[-1] == 0.0


def test_lattice_at_rest_has_its_density(shared: SharedLaw):
    """Sum the kernel over a lattice at rest to the rest density."""
    axis = np.arange(-2, 3) * SPACING
    lattice = np.stack(np.meshgrid(axis, axis, axis), -1).reshape(-1, 3)
    distance = np.linalg.norm(lattice, axis=1)
    value, slope, hold = (wp.zeros(len(distance), dtype=float, device="cpu") for _ in range(3))
    inputs = [shared, numbers(distance), value, slope, hold]
    wp.launch(tabulate_kernel, dim=len(distance), inputs=inputs, device="cpu")
    assert value.numpy().sum() * shared.inverse_rest_sum == pytest.approx(1.0, rel=1e-5)


def test_flow_leaves_the_yield_stress(shared: SharedLaw):
    """Relax shear in any direction to the yield stress, regardless of pressure."""
    own = particle_law(Material())
    random = np.random.default_rng(1)
    shears = random.normal(size=(50, 3, 3))
    shears = 0.5 * (shears + shears.transpose(0, 2, 1))
    shears -= np.trace(shears, axis1=1, axis2=2)[:, None, None] / 3.0 * np.eye(3)
    # Each bond belongs to two particles; its stiffness is the shear modulus times the spacing.
    shears /= np.sqrt(0.5 * (shears**2).sum((1, 2)))[:, None, None]
    unit = 2.0 * SPACING**2 / own.shear_modulus
    over = random.uniform(0.5, 4.0, 50)
    stress = own.yield_stress * over
    stretch = shears * (unit * stress)[:, None, None]
    stretch += random.normal(size=50)[:, None, None] * np.eye(3) * unit * own.yield_stress
    share = wp.zeros(50, dtype=float, device="cpu")
    table = wp.array(stretch, dtype=wp.mat33, device="cpu")
    wp.launch(share_of_stretch, dim=50, inputs=[shared, own, table, share], device="cpu")
    left = stress * (1.0 - share.numpy())
    np.testing.assert_allclose(left, np.minimum(stress, own.yield_stress), rtol=1e-4)


def test_bond_draws_out_at_its_tension_limit(shared: SharedLaw):
    """Follow the flow fraction up to the limit, and carry no more than that beyond it."""
    limit, rest = 0.1 * SPACING, SPACING
    distance = np.linspace(0.9, 1.3, 41) * SPACING
    for share in (0.0, 0.3):
        bond = wp.zeros(len(distance), dtype=wp.vec2, device="cpu")
        inputs = [shared, limit, rest, numbers(distance), share, bond]
        wp.launch(flow_bonds, dim=len(distance), inputs=inputs, device="cpu")
        flowed, softening = bond.numpy().T
        expected = np.minimum((1.0 - share) * (distance - rest), limit)
        np.testing.assert_allclose(distance - flowed, expected, atol=1e-6 * SPACING)
        moved = np.abs(distance - rest) > 1e-3 * SPACING
        secant = expected[moved] / (distance - rest)[moved]
        # If a bond yields and draws out at once, the softening exceeds the secant.
        assert (softening[moved] >= secant * (1.0 - 1e-3)).all()
        one_way = (expected[moved] < limit) | (share == 0.0)
        np.testing.assert_allclose(softening[moved][one_way], secant[one_way], rtol=1e-3)


@pytest.mark.parametrize("index", [1.0, 0.5])
def test_damping_has_the_stress_of_the_material(shared: SharedLaw, index: float):
    """Damp pairs so that the shear stress grows as a power of the strain rate."""
    own = particle_law(Material(flow_index=index))
    shear = np.geomspace(0.1, 100.0, 7)
    squares = 28.0 * SPACING**2
    # Simple shear: D : D = γ̇² / 2; separation rates have a mean square of 2/15 of that.
    rates = squares * (2.0 / 15.0) * 0.5 * shear**2
    damping = wp.zeros(len(shear), dtype=float, device="cpu")
    inputs = [shared, own, squares, numbers(rates), damping]
    wp.launch(damp, dim=len(shear), inputs=inputs, device="cpu")
    viscosity = damping.numpy() * squares / (law.DAMPING_OF_VISCOSITY * SPACING**3)
    np.testing.assert_allclose(viscosity * shear, own.consistency * shear**index, rtol=1e-4)


@pytest.mark.parametrize(
    "block",
    [
        measures_cpu.gather_block,
        measures_cpu.gather_one,
        measures_cpu.measure_block,
        forces_cpu.sum_forces_block,
        forces_cpu.flow_block,
        products_cpu.press_block,
        products_cpu.multiply_block,
    ],
    ids=lambda block: block.key,
)
def test_vector_units_use_the_same_source(block: wp.Function):
    """Include the formulas verbatim in every pass for the vector units."""
    assert law.FORMULAS in block.native_snippet


@pytest.mark.parametrize(
    "name",
    ["rows", "measures", "measures_cpu", "forces", "forces_cpu", "products", "products_cpu"],
)
def test_passes_have_no_constants_of_their_own(name: str):
    """Keep every number but 0, a half and 1 in the law's module."""
    source = (BONDS / "pairs" / f"{name}.py").read_text(encoding="utf-8")
    _licence, text = source.split("\n", 1)
    literals = re.findall(r"(?<![\w.])(?:\d+\.\d*|\d+(?=[ef]))(?:e[-+]?\d+)?", text)
    assert {float(number) for number in literals} <= {0.0, 0.5, 1.0}
