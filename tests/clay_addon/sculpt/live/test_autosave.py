# SPDX-License-Identifier: GPL-3.0-or-later
"""Autosave of a session's clay, and its recovery."""

from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from tactile_clay.clay_addon.model.clay_points import is_sculpted, write_points
from tactile_clay.clay_addon.sculpt.live.autosave import Autosave, autosave_path, recover, recovery


def pressed(studio: Any, clay: Any) -> Any:
    """Flatten a block, as a session might; returns its points in local coordinates."""
    local = studio.points(clay) - np.array(clay.matrix_world.translation, np.float32)
    local[:, 2] *= 0.5
    write_points(clay, local)
    return local


def test_clay_is_recovered_when_its_file_is_opened(studio: Any, tmp_path: Path) -> None:
    """Recover the autosaved clay, and report it."""
    clay = studio.clay()
    path = studio.save(tmp_path)
    saved = Autosave()
    local = pressed(studio, clay)
    saved.begin(studio.scene)
    saved._executor.shutdown(wait=True)
    beside = autosave_path(str(path))
    assert beside is not None and beside.is_file()
    bpy.ops.wm.open_mainfile(filepath=str(path))
    clay = bpy.data.objects["Clay"]
    found = studio.points(clay) - np.array(clay.matrix_world.translation, np.float32)
    np.testing.assert_allclose(found, local, atol=1e-6)
    assert is_sculpted(clay)
    assert "Clay was recovered from its autosave" in recovery.message


def test_newer_file_is_left_alone(studio: Any, tmp_path: Path) -> None:
    """Delete an autosave that is older than the file."""
    clay = studio.clay()
    path = studio.save(tmp_path)
    saved = Autosave()
    pressed(studio, clay)
    saved.begin(studio.scene)
    saved._executor.shutdown(wait=True)
    write_points(clay, np.zeros((64, 3), np.float32) + np.arange(64)[:, None] * 0.01)
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=str(path))
    assert not recovery.message
    beside = autosave_path(str(path))
    assert beside is not None and not beside.exists()


@pytest.mark.parametrize("damage", ["cut", "empty", "text"])
def test_damaged_autosave_is_reported_and_changes_nothing(
    studio: Any, tmp_path: Path, damage: str
) -> None:
    """Leave the clay as it is in the file."""
    clay = studio.clay()
    path = studio.save(tmp_path)
    before = studio.points(clay)
    saved = Autosave()
    pressed(studio, clay)
    saved.begin(studio.scene)
    saved._executor.shutdown(wait=True)
    beside = autosave_path(str(path))
    assert beside is not None
    content = beside.read_bytes()
    beside.write_bytes({"cut": content[:300], "empty": b"", "text": b"no clay"}[damage])
    bpy.ops.wm.open_mainfile(filepath=str(path))
    np.testing.assert_array_equal(studio.points(bpy.data.objects["Clay"]), before)
    assert "could not be recovered" in recovery.message
    with pytest.raises(ValueError, match="cannot be read"):
        recover(bpy.context, beside)


def test_clay_with_another_number_of_points_is_recovered(studio: Any, tmp_path: Path) -> None:
    """Recover clay that was added during the session."""
    clay = studio.clay()
    path = studio.save(tmp_path)
    from tactile_clay.clay_addon.model.clay_points import replace_points

    local = np.random.default_rng(1).uniform(-0.02, 0.02, (100, 3)).astype(np.float32)
    replace_points(bpy.context, clay, local, np.ones((100, 4), np.float32))
    saved = Autosave()
    saved.begin(studio.scene)
    saved._executor.shutdown(wait=True)
    bpy.ops.wm.open_mainfile(filepath=str(path))
    assert len(bpy.data.objects["Clay"].data.points) == 100


def test_file_that_was_never_saved_is_reported(studio: Any) -> None:
    """Say that a crash would lose the clay."""
    studio.clay()
    saved = Autosave()
    saved.begin(studio.scene)
    assert "a crash loses the clay" in saved.problem
    saved.close()
