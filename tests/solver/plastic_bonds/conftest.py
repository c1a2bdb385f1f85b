# SPDX-License-Identifier: GPL-3.0-or-later
"""Clay in the middle of a press, on which passes are tested."""

import numpy as np
import pytest

from tactile_clay.solver import Material, Scene, Solver
from tactile_clay.solver.plastic_bonds.model import PlasticBonds
from tactile_clay.tests.experiments.shapes import at, ball, block

SPACING = 0.005


@pytest.fixture(scope="module")
def pressed() -> PlasticBonds:
    """Two materials in the middle of a press: compressed, stretched and yielding."""
    scene = Scene(SPACING)
    points = block((16, 9, 9), SPACING)
    points += np.random.default_rng(1).uniform(-0.1, 0.1, points.shape) * SPACING
    left = points[:, 0] < 0
    thin = Material(yield_stress=2e3, density=1200.0, shear_modulus=5e4, flow_index=0.5)
    scene.add_clay(points[left], Material())
    scene.add_clay(points[~left], thin)
    scene.add_plane()
    sphere = ball(0.01)
    tool = scene.add_mesh(sphere.vertices, sphere.faces)
    tool.set_pose(at(0, 0, 0.057))
    solver = Solver(scene)
    for frame in range(10):
        tool.set_pose(at(0, 0, 0.057 - 0.001 * frame))
        solver.step(1 / 60)
    model = solver._model
    assert isinstance(model, PlasticBonds)
    assert model.compression().max() > 0
    assert model.coarse.size.numpy()[0] > 6
    return model
