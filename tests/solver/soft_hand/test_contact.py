# SPDX-License-Identifier: GPL-3.0-or-later
"""Transfer of forces on the skin to ghosts and nodes."""

import numpy as np
import pytest
import warp as wp
from hypothesis import given
from hypothesis import strategies as st

from tactile_clay.solver import HandRig, Material, Scene, Solver
from tactile_clay.solver.soft_hand.contact import _distance_to_triangles, make_skin
from tactile_clay.tests.experiments.hand_shapes import finger, posed
from tactile_clay.tests.experiments.shapes import at, block

SPACING = 0.005
COORDINATES = st.lists(st.floats(-1, 1), min_size=3, max_size=3)


@pytest.fixture(scope="module")
def rig() -> HandRig:
    """A finger that points down."""
    return finger(0.009)


@given(COORDINATES)
def test_distance_to_a_triangle(point: list[float]):
    """Agree with the distance to the nearest of many points on the triangle."""
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.1, 0.0], [0.2, 0.8, 0.3]])
    steps = np.linspace(0.0, 1.0, 81)
    first, second = np.meshgrid(steps, steps)
    inside = first + second <= 1.0
    weights = np.column_stack([1.0 - first[inside] - second[inside], first[inside], second[inside]])
    nearest = np.linalg.norm(weights @ corners - point, axis=1).min()
    found = _distance_to_triangles(np.array([point]), corners[None])[0]
    assert found <= nearest + 1e-9
    assert found == pytest.approx(nearest, abs=0.02)


def test_every_face_has_ghosts_on_its_own_side(rig: HandRig):
    """Have ghosts for every face, none of them on the opposite side of the finger."""
    skin = make_skin(rig, 0, SPACING, wp.get_device("cpu"))
    begin, ghosts = skin.ghost_begin.numpy(), skin.ghost.numpy()
    assert (np.diff(begin) > 0).all()
    corners = rig.vertices[rig.faces]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    faces = np.repeat(np.arange(len(rig.faces)), np.diff(begin))
    assert (np.einsum("ij,ij->i", rig.ghost_normals[ghosts], outward[faces]) > 0.0).all()
    away = np.linalg.norm(rig.carried_ghosts(rig.nodes)[ghosts] - corners[faces].mean(1), axis=1)
    assert away.max() < 2.0 * SPACING


def test_forces_on_ghosts_sum_to_the_force_of_the_clay(rig: HandRig):
    """Sum to the force on the hand, act near the clay, and push against the skin."""
    scene = Scene(SPACING)
    scene.add_clay(block((6, 6, 4), SPACING), Material())
    scene.add_plane()
    hand = scene.add_hand(rig)
    hand.set_bones(posed(rig, at(0.0, 0.0, 0.0195)))
    solver = Solver(scene)
    for frame in range(10):
        hand.set_bones(posed(rig, at(0.0, 0.0, 0.0195 - 0.0004 * frame)))
        solver.step(1 / 60)
    contacts = solver.contacts(hand)
    assert len(contacts.positions) == len(rig.ghost_areas)
    np.testing.assert_allclose(contacts.forces.sum(0), solver.force_on(hand), rtol=1e-9)
    assert contacts.forces[:, 2].sum() > 0.5
    touched = np.linalg.norm(contacts.forces, axis=1) > 0.0
    gaps = np.linalg.norm(contacts.positions[touched, None] - solver.positions()[None], axis=2).min(
        1
    )
    assert gaps.max() < SPACING
    # Apart from friction, clay pushes against the skin.
    pressing = np.einsum("gi,gi->g", contacts.forces, contacts.normals)
    assert pressing.sum() < -0.8 * np.linalg.norm(contacts.forces, axis=1).sum()
    np.testing.assert_allclose(np.linalg.norm(contacts.normals, axis=1), 1.0)
    assert contacts.areas.sum() == pytest.approx(rig.ghost_areas.sum())
