# SPDX-License-Identifier: GPL-3.0-or-later
"""Focal points of a bake as keyframed empties: positions, pressures and absence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from tactile_clay.clay_addon.bake.bake import bake
from tactile_clay.clay_addon.core.storage.cache import Cache
from tactile_clay.clay_addon.core.storage.foci import FociFrame, write_foci
from tactile_clay.clay_addon.touch.foci_empties import follow_foci


def frame(number: int, positions: Any, pressures: Any) -> FociFrame:
    """Focal points of one frame."""
    return FociFrame(
        number,
        np.array(positions, np.float32).reshape(-1, 3),
        np.array(pressures, np.float32),
        0.0086,
    )


def test_points_are_followed_in_any_order() -> None:
    """Follow each point whatever its order in the frames, and mark gaps as absent."""
    rng = np.random.default_rng(0)
    paths = np.array([[0.0, 0, 0], [0.05, 0, 0], [0, 0.05, 0]]) + np.cumsum(
        rng.normal(0, 0.002, (12, 3, 3)), axis=0
    )
    frames = {}
    for number in range(12):
        order = rng.permutation(3)
        frames[number] = frame(number, paths[number][order], 100.0 * (order + 1))
    frames[6] = frame(6, paths[6][1:2], [200.0])
    tracks = follow_foci(frames, reach=0.03)
    assert tracks.pressures.shape == (12, 3)
    for number in (0, 5, 6):
        present = tracks.pressures[number] > 0
        assert sorted(tracks.pressures[number][present]) == sorted(frames[number].pressures)
    # The point present in all frames keeps its pressure and its path.
    (steady,) = np.flatnonzero((tracks.pressures > 0).all(axis=0))
    assert set(tracks.pressures[:, steady]) == {200.0}
    np.testing.assert_allclose(tracks.positions[:, steady], paths[:, 1], atol=1e-7)


def test_distant_points_are_not_joined() -> None:
    """Do not take a distant new point for one that has disappeared."""
    frames = {1: frame(1, [[0, 0, 0]], [100]), 2: frame(2, [[1, 0, 0]], [100])}
    tracks = follow_foci(frames, reach=0.05)
    assert tracks.pressures.shape == (2, 1)
    frames = {1: frame(1, [[0, 0, 0]], [100]), 2: frame(2, [[1, 0, 0], [0.01, 0, 0]], [50, 100])}
    tracks = follow_foci(frames, reach=0.05)
    np.testing.assert_allclose(tracks.positions[1, 0], [0.01, 0, 0])
    assert tracks.pressures[:, 1].tolist() == [0, 50]


def test_empties_show_the_recorded_focal_points(studio: Any, tmp_path: Path) -> None:
    """Reproduce positions, pressures and absence at every frame; replace earlier empties."""
    studio.falling_block(tmp_path, end=4)
    assert "no bake" in studio.refused(bpy.ops.clay.foci_empties)
    cache = Cache(bake(bpy.context).directory)
    assert "recorded no focal points" in studio.refused(bpy.ops.clay.foci_empties)
    meta = cache.meta()
    for recorded in (
        frame(2, [[0.1, 0, 0], [0, 0.2, 0]], [400, 100]),
        frame(3, [[0.12, 0, 0]], [200]),
    ):
        write_foci(cache.directory, recorded, meta)
    for _ in range(2):
        assert bpy.ops.clay.foci_empties() == {"FINISHED"}
    empties = [item for item in studio.scene.objects if item.type == "EMPTY"]
    assert len(empties) == 2
    strong, weak = empties
    seen = {}
    for number in range(1, 6):
        studio.scene.frame_set(number)
        seen[number] = (strong.hide_render, weak.hide_render, strong.hide_viewport)
    assert seen == {
        1: (True, True, True),
        2: (False, False, False),
        3: (False, True, False),
        4: (True, True, True),
        5: (True, True, True),
    }
    for number, place, size, pressure in ((2, 0.1, 1.0, 400), (3, 0.12, 0.5, 200)):
        studio.scene.frame_set(number)
        assert strong.location.x == pytest.approx(place)
        assert strong.scale.x == pytest.approx(size)
        assert strong["pressure"] == pytest.approx(pressure)
    assert strong.empty_display_size == pytest.approx(0.0086)
