# SPDX-License-Identifier: GPL-3.0-or-later
"""Restoring the clay of a snapshot among other tools."""

import numpy as np
import pytest
import trimesh

from tactile_clay.solver import Material, Scene, Solver

SPACING = 0.005


def solver(*, tool: bool = False, count: int = 6, apart: float = 0.0) -> Solver:
    """A block floating in the air, its halves ``apart`` [m], optionally with a tool."""
    row = np.arange(count) * SPACING
    points = np.stack(np.meshgrid(row, row, row, indexing="ij"), -1).reshape(-1, 3)
    points[len(points) // 2 :, 0] += apart
    scene = Scene(spacing=SPACING, gravity=(0.0, 0.0, 0.0))
    scene.add_clay(points, Material.preset("plasticine"))
    if tool:
        ball = trimesh.creation.icosphere(1, 0.01)
        scene.add_mesh(ball.vertices + np.array((0.0, 0.0, 0.2)), ball.faces)
    return Solver(scene, device="cpu")


def test_clay_stays_separate_when_a_tool_is_added() -> None:
    """Keep halves apart that a solver built from their points would join."""
    parted = solver(apart=0.45 * SPACING)
    # The halves lie closer than the bond reach of a new solver, but are not bonded.
    state = parted.snapshot()
    again = solver(tool=True, apart=0.45 * SPACING)
    again.restore_clay(state)
    ours, theirs = again.snapshot(), state
    for name in ("position", "velocity", "neighbor_other", "neighbor_rest_length"):
        np.testing.assert_array_equal(ours[name], theirs[name])
    for _ in range(3):
        parted.step(1 / 60)
        again.step(1 / 60)
    np.testing.assert_allclose(again.positions(), parted.positions(), atol=1e-6)


def test_clay_of_another_block_is_refused() -> None:
    """Leave the state unchanged if the snapshot has other particles."""
    block = solver()
    before = block.positions()
    with pytest.raises(ValueError, match="another scene"):
        block.restore_clay(solver(count=5).snapshot())
    np.testing.assert_array_equal(block.positions(), before)
