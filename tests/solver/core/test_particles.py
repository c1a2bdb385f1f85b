# SPDX-License-Identifier: GPL-3.0-or-later
"""Launching passes over particles."""

import numpy as np
import pytest
import warp as wp

from tactile_clay.solver import Material, Scene
from tactile_clay.solver.core.awake import Awake
from tactile_clay.solver.core.particles import ByPart, Particles
from tactile_clay.solver.core.vector_units import BLOCK


@wp.kernel(enable_backward=False)
def mark_blocks(awake: Awake, marks: wp.array[int]) -> None:
    """Count the threads of each block."""
    wp.atomic_add(marks, wp.tid(), 1)


@pytest.mark.parametrize("count", [1, 63, 64, 65, 384, 2048, 2100])
@pytest.mark.parametrize("awake", [1.0, 0.4])
def test_passes_by_block_run_no_block_too_many(count: int, awake: float):
    """Run one thread for each block of a part and no more, since lists have no room for more."""
    scene = Scene(0.005)
    scene.add_clay(np.random.default_rng(0).uniform(size=(count, 3)), Material())
    particles = Particles(scene, wp.get_device("cpu"))
    chosen = np.arange(max(1, int(awake * count)))
    particles.set_awake(chosen)
    room = -(-count // BLOCK)
    marks = wp.zeros((particles.parts, room + 4), dtype=int, device="cpu")
    particles.launch_blocks(mark_blocks, ByPart.rows(marks))
    visited = marks.numpy()
    assert visited[:, room:].sum() == 0
    for part, own in enumerate(np.array_split(chosen, particles.parts)):
        assert (visited[part, : -(-len(own) // BLOCK)] == 1).all()
