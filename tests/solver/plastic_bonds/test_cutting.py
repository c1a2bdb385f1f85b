# SPDX-License-Identifier: GPL-3.0-or-later
"""Cutting of bonds across a collider thinner than they are long."""

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from tactile_clay.solver import Material, Scene, Settings, Solver
from tactile_clay.solver.plastic_bonds import cutting
from tactile_clay.solver.plastic_bonds.model import PlasticBonds
from tactile_clay.tests.experiments.shapes import block

SPACING = 0.005
LOWEST = 0.02
"""Lower edge of the blade [m]."""


@pytest.fixture
def cut() -> PlasticBonds:
    """A block with a thin blade between two of its layers, from above to half its depth."""
    scene = Scene(SPACING, gravity=(0.0, 0.0, 0.0))
    scene.add_clay(block((8, 6, 8), SPACING), Material())
    blade = trimesh.creation.box((0.2 * SPACING, 20 * SPACING, 0.1))
    blade.apply_translation((0.0, 0.0, LOWEST + 0.05))
    scene.add_mesh(blade.vertices, blade.faces)
    solver = Solver(scene, Settings(substeps=1))
    model = solver._model
    assert isinstance(model, PlasticBonds)
    before = bonds(model)
    assert across(model, before).any()
    solver.step(1 / 60)
    return model


def bonds(model: PlasticBonds) -> NDArray[np.int64]:
    """Both ends of each bond, shape [B, 2]."""
    rows = model.pairs.rows
    first, count = rows.first.numpy(), rows.acting.numpy()
    other, rest = rows.other.numpy(), rows.rest_length.numpy()
    return np.array(
        [
            (i, other[slot])
            for i in range(len(first))
            for slot in range(first[i], first[i] + count[i])
            if rest[slot] > 0
        ]
    )


def across(model: PlasticBonds, ends: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether each bond crosses the blade, shape [B]."""
    position = model.particles.position.numpy()[ends]
    side = position[:, :, 0] > 0
    return (side[:, 0] != side[:, 1]) & (position[:, :, 2] > LOWEST).all(1)


def test_blade_cuts_the_bonds_across_it(cut: PlasticBonds):
    """Leave no bond across the blade, and all bonds below it and beside it."""
    ends = bonds(cut)
    assert not across(cut, ends).any()
    position = cut.particles.position.numpy()[ends]
    side = position[:, :, 0] > 0
    assert (side[:, 0] != side[:, 1]).any()
    assert (side[:, 0] == side[:, 1]).sum() > 0.7 * len(ends)


def test_both_kernels_cut_the_same(cut: PlasticBonds):
    """Cut the same bonds block by block as particle by particle."""
    rows, contacts = cut.pairs.rows, cut.contacts
    lengths = rows.rest_length.numpy().copy()
    first, count = rows.first.numpy(), rows.acting.numpy()
    slots = np.concatenate([np.arange(f, f + c) for f, c in zip(first, count, strict=True)])
    lengths[slots] = SPACING
    rows.rest_length.assign(lengths)
    cutting.cut_all_bonds(contacts, rows)
    by_block = rows.rest_length.numpy().copy()
    rows.rest_length.assign(lengths)
    inputs = [contacts.plane_count, cut.particles.position, contacts.slots, rows]
    cut.particles.launch(cutting.cut_bonds, *inputs)
    assert (by_block[slots] == 0).any()
    np.testing.assert_array_equal(rows.rest_length.numpy(), by_block)
