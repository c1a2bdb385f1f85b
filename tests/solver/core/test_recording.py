# SPDX-License-Identifier: GPL-3.0-or-later
"""Recorded passes against the same passes launched individually."""

from collections.abc import Callable, Hashable

import numpy as np
import pytest

from tactile_clay.solver import Material, Scene, Solver
from tactile_clay.solver.core import recording
from tactile_clay.solver.core.recording import Recordings
from tactile_clay.tests.experiments.shapes import at, ball, block

SPACING = 0.005


def scatter() -> np.ndarray:
    """Throw three blocks apart past a moving ball, so that cells and substeps keep changing."""
    scene = Scene(SPACING)
    for shift, speed in ((-0.02, -1.5), (0.0, 0.0), (0.02, 1.5)):
        clay = block(3, SPACING, (shift, 0.0, 0.002))
        scene.add_clay(clay, Material(), velocities=(speed, 0.2 * speed, 0.0))
    scene.add_plane(friction=0.1)
    sphere = ball(0.01)
    tool = scene.add_mesh(sphere.vertices, sphere.faces)
    tool.set_pose(at(0, 0, 0.03))
    solver = Solver(scene)
    for frame in range(24):
        tool.set_pose(at(0, 0, 0.03 - 0.0001 * frame**2 % 0.012))
        solver.step(1 / 60)
    return solver.positions()


def test_replayed_passes_give_the_bits_of_launched_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Yield the same bits whether passes are replayed or launched, even if arrays are replaced."""
    replayed = scatter()

    def launch_plainly(self: Recordings, key: Hashable, launch: Callable[[], None]) -> None:
        launch()

    monkeypatch.setattr(Recordings, "run", launch_plainly)
    np.testing.assert_array_equal(replayed, scatter())


def test_two_threads_give_the_bits_of_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Yield the same bits with one thread and two, through trials of both."""
    results = []
    for threads in (1, 2):
        monkeypatch.setattr(recording, "processor_count", lambda count=threads: count)
        monkeypatch.setattr(recording, "TRIAL_START", 4)
        monkeypatch.setattr(recording, "TRIAL_INTERVAL", 16)
        scene = Scene(SPACING)
        scene.add_clay(block(12, SPACING), Material())
        scene.add_plane()
        sphere = ball(0.01)
        tool = scene.add_mesh(sphere.vertices, sphere.faces)
        tool.set_pose(at(0, 0, 0.071))
        solver = Solver(scene)
        for frame in range(12):
            tool.set_pose(at(0, 0, 0.071 - 0.001 * frame))
            solver.step(1 / 60)
        results.append(solver.positions())
    np.testing.assert_array_equal(results[0], results[1])
