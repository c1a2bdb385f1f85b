# SPDX-License-Identifier: GPL-3.0-or-later
"""Playback of a bake from its folder."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tactile_clay.clay_addon.core.storage.cache import (
    Cache,
    CacheMissingError,
    ClaySlice,
    Frame,
    Meta,
)
from tactile_clay.clay_addon.core.storage.playback import Playback, held_frame, shown_frame

META = Meta(1, 3, 24.0, (ClaySlice("Clay", 3), ClaySlice("Lump", 2)), {})


def test_each_object_gets_its_points(tmp_path: Path) -> None:
    """A frame is split into the positions and velocities of each object."""
    cache = Cache(tmp_path)
    cache.begin(META, np.ones((5, 4)))
    rows = np.arange(15, dtype=np.float32).reshape(5, 3)
    cache.write_frame(Frame(2, rows, -rows), META)
    playback = Playback(cache)
    assert playback.frames() == [2]
    frame = playback.frame(2)
    assert frame.number == 2
    for parts, expected in ((frame.positions, rows), (frame.velocities, -rows)):
        assert [len(part) for part in parts] == [3, 2]
        np.testing.assert_array_equal(np.concatenate(parts), expected)
    with pytest.raises(CacheMissingError):
        playback.frame(3)


def test_metadata_is_read_again_when_it_changes(tmp_path: Path) -> None:
    """The metadata is cached until its file is rewritten."""
    cache = Cache(tmp_path)
    cache.begin(META, np.ones((5, 4)))
    playback = Playback(cache)
    assert playback.meta() is playback.meta()
    cache.write_meta(replace(META, end=9))
    later = (tmp_path / "meta.json").stat().st_mtime_ns + 1_000_000_000
    os.utime(tmp_path / "meta.json", ns=(later, later))
    assert playback.meta().end == 9


def test_a_folder_without_a_bake_has_no_frames(tmp_path: Path) -> None:
    """A missing bake is reported without creating the folder."""
    playback = Playback(Cache(tmp_path / "none"))
    assert playback.frames() == []
    with pytest.raises(CacheMissingError):
        playback.meta()
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("number", "hold", "shown"),
    [(-5, 1, 3), (3, 1, 3), (5, 1, 5), (99, 1, 8), (4, 2, 3), (5, 2, 5), (99, 4, 7)],
)
def test_first_and_last_frames_and_each_shape_are_held(number: int, hold: int, shown: int) -> None:
    """Outside its range a bake shows its first or last frame; within, each shape is held."""
    assert shown_frame([3, 4, 5, 6, 7, 8], number, hold=hold) == shown


def test_held_frames_are_counted_from_the_first() -> None:
    """Holding starts at the first frame of the bake."""
    assert [held_frame(n, first=3, hold=2) for n in range(3, 8)] == [3, 3, 5, 5, 7]
    with pytest.raises(CacheMissingError):
        shown_frame([], 1, hold=1)
