# SPDX-License-Identifier: GPL-3.0-or-later
"""Flesh compared with analytic results of elasticity."""

import numpy as np
import pytest
import trimesh
import warp as wp
from numpy.typing import NDArray

from tactile_clay.solver.hand.rig import HandRig
from tactile_clay.solver.soft_hand.elasticity import STIFFENING_STRAIN
from tactile_clay.solver.soft_hand.flesh import Flesh
from tactile_clay.solver.soft_hand.rest import flesh_rest
from tactile_clay.tests.experiments.hand_shapes import bind, finger, lattice

YOUNG = 5.0e4


def make_flesh(rig: HandRig, poisson_ratio: float = 0.45, iterations: int = 80) -> Flesh:
    """Flesh on the CPU."""
    return Flesh(
        rig,
        flesh_rest(rig),
        young_modulus=YOUNG,
        poisson_ratio=poisson_ratio,
        iterations=iterations,
        device=wp.get_device("cpu"),
    )


def settle(flesh: Flesh, load: NDArray[np.float64], steps: int = 12) -> NDArray[np.float64]:
    """Positions of the nodes in equilibrium with a load [m], shape [N, 3]."""
    force = wp.array(load, dtype=wp.vec3, device="cpu")
    for _ in range(steps):
        flesh.stretch()
        flesh.stiffen()
        flesh.relax(force, 1.0)
    return flesh.data.position.numpy().astype(float)


def bar() -> HandRig:
    """A bar of 60 x 20 x 20 mm whose left end is attached to a bone."""
    skin = trimesh.creation.box((0.06, 0.02, 0.02))
    nodes, tetrahedra = lattice(skin.vertices, skin.faces, 0.005)
    heads = np.array([[-0.03, 0, 0], [-0.025, 0, 0], [-0.0249, 0, 0]])
    weights = np.tile((1.0, 0.0, 0.0), (len(nodes), 1))
    return bind(skin, heads, [-1, 0, 1], weights, nodes, tetrahedra, 0.0025)


def pull(rig: HandRig, force: float) -> NDArray[np.float64]:
    """Load on the nodes that pulls uniformly at the right end [N], shape [N, 3]."""
    ghosts = rig.carried_ghosts(rig.nodes)
    end = rig.ghost_normals[:, 0] > 0.9
    share = np.where(end, rig.ghost_areas, 0.0)
    load = np.zeros_like(rig.nodes)
    corners = rig.tetrahedra[rig.ghost_tetrahedron]
    for k in range(4):
        part = force * share / share.sum() * rig.ghost_weights[:, k]
        np.add.at(load[:, 0], corners[:, k], part)
    assert ghosts[end, 0].min() == pytest.approx(0.03)
    return load


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.45])
def test_a_bar_stretches_by_force_over_young_modulus(poisson_ratio: float):
    """Stretch by F L / (E A) away from the ends, and become thinner by Poisson's ratio."""
    rig = bar()
    force = 0.2
    nodes = settle(make_flesh(rig, poisson_ratio), pull(rig, force))
    strain = force / (YOUNG * 0.02**2)
    middle = np.abs(rig.nodes[:, 0]) < 0.011
    inside = middle & (np.abs(rig.nodes[:, 1:]) < 0.0099).all(1)
    moved = nodes - rig.nodes
    along = np.polyfit(rig.nodes[inside, 0], moved[inside, 0], 1)[0]
    across = np.polyfit(rig.nodes[inside, 1], moved[inside, 1], 1)[0]
    # Volume outside the skin counts by a tenth, and stiffens the bar slightly.
    assert along == pytest.approx(strain, rel=0.12)
    assert across == pytest.approx(-poisson_ratio * strain, abs=0.06 * strain)


def test_flesh_stiffens_under_large_strain():
    """Yield less and less: at the stiffening strain, half as much as linear flesh."""
    rig = bar()
    strains = []
    for force in (0.2, 2.0 * STIFFENING_STRAIN * YOUNG * 0.02**2):
        nodes = settle(make_flesh(rig), pull(rig, force), steps=40)
        inside = (np.abs(rig.nodes[:, 0]) < 0.011) & (np.abs(rig.nodes[:, 1:]) < 0.0099).all(1)
        strains.append(np.polyfit(rig.nodes[inside, 0], (nodes - rig.nodes)[inside, 0], 1)[0])
    linear = strains[0] / 0.2 * 2.0 * STIFFENING_STRAIN * YOUNG * 0.02**2
    assert strains[1] == pytest.approx(0.5 * linear, rel=0.1)


def test_the_tangent_is_the_derivative_of_the_forces():
    """Predict the change of the forces in flesh that is already strained."""
    rig = bar()
    flesh = make_flesh(rig)
    settle(flesh, pull(rig, 3.0))
    at = flesh.data.position.numpy().astype(float)

    def forces(nodes: NDArray[np.float64]) -> NDArray[np.float64]:
        flesh.data.position.assign(nodes.astype(np.float32))
        flesh.stretch()
        return flesh.data.inner.numpy().astype(float)

    # A stretch along the bar and across it rotates no tetrahedron.
    motion = (rig.nodes - rig.nodes.mean(0)) * (0.02, -0.01, 0.005)
    change = (forces(at + 0.5 * motion) - forces(at - 0.5 * motion)).ravel()
    flesh.data.position.assign(at.astype(np.float32))
    flesh.stretch()
    flesh.stiffen()
    predicted = -multiply(flesh, motion).ravel()
    assert np.linalg.norm(change - predicted) < 0.03 * np.linalg.norm(predicted)


def multiply(flesh: Flesh, motion: NDArray[np.float64]) -> NDArray[np.float64]:
    """The tangent times a motion of the nodes [N]."""
    data = flesh.data
    row, column, block = data.row.numpy(), data.column.numpy(), data.block.numpy()
    rows = np.repeat(np.arange(flesh.count), np.diff(row))
    product = np.zeros_like(motion)
    np.add.at(product, rows, np.einsum("bij,bj->bi", block, motion[column]))
    return product


@pytest.mark.parametrize("edge", [0.009, 0.006])
def test_flesh_at_rest_stays_at_rest(edge: float):
    """Move no node without a load."""
    rig = finger(edge)
    flesh = make_flesh(rig, iterations=6)
    nodes = settle(flesh, np.zeros_like(rig.nodes), steps=50)
    np.testing.assert_allclose(nodes, rig.nodes, atol=1e-7)


def test_bones_carry_flesh_without_strain():
    """Move flesh like a rigid body if all bones do."""
    rig = finger(0.009)
    flesh = make_flesh(rig)
    pose = trimesh.transformations.euler_matrix(0.5, 1.0, -0.7)
    pose[:3, 3] = (0.1, -0.2, 0.3)
    turn = trimesh.transformations.quaternion_from_matrix(pose)
    bones = len(rig.bone_names)
    flesh.data.skinning.assign(np.tile(pose, (bones, 1, 1)).astype(np.float32))
    flesh.data.bone_frame.assign(np.tile(np.roll(turn, -1), (bones, 1)).astype(np.float32))
    flesh.carry()
    nodes = settle(flesh, np.zeros_like(rig.nodes), steps=5)
    np.testing.assert_allclose(nodes, rig.nodes @ pose[:3, :3].T + pose[:3, 3], atol=1e-6)


def test_flesh_recovers_from_random_displacements():
    """Return to the rest shape after random displacements that invert tetrahedra."""
    rig = finger(0.009)
    flesh = make_flesh(rig, iterations=6)
    displaced = rig.nodes + np.random.default_rng(0).normal(0.0, 0.004, rig.nodes.shape)
    flesh.data.position.assign(displaced.astype(np.float32))
    corners = displaced[rig.tetrahedra]
    assert (np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0.0).mean() > 0.05
    nodes = settle(flesh, np.zeros_like(rig.nodes), steps=60)
    np.testing.assert_allclose(nodes, rig.nodes, atol=1e-4)


def test_a_load_that_is_not_finite_resets_nodes_to_their_bones():
    """Keep all nodes finite."""
    rig = finger(0.009)
    load = np.zeros_like(rig.nodes)
    load[3] = np.nan
    nodes = settle(make_flesh(rig), load, steps=1)
    assert np.isfinite(nodes).all()
