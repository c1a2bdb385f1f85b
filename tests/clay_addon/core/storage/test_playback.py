# SPDX-License-Identifier: GPL-3.0-or-later
"""Playing a bake from its folder."""

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
    """Read a frame as the positions and velocities of each object."""
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


def test_description_is_read_again_when_it_changes(tmp_path: Path) -> None:
    """Keep what the bake was made from, until its file is written anew."""
    cache = Cache(tmp_path)
    cache.begin(META, np.ones((5, 4)))
    playback = Playback(cache)
    assert playback.meta() is playback.meta()
    cache.write_meta(replace(META, end=9))
    later = (tmp_path / "meta.json").stat().st_mtime_ns + 1_000_000_000
    os.utime(tmp_path / "meta.json", ns=(later, later))
    assert playback.meta().end == 9


def test_a_folder_without_a_bake_has_no_frames(tmp_path: Path) -> None:
    """Tell that there is no bake, without making anything on the disk."""
    playback = Playback(Cache(tmp_path / "none"))
    assert playback.frames() == []
    with pytest.raises(CacheMissingError):
        playback.meta()
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("number", "hold", "shown"),
    [(-5, 1, 3), (3, 1, 3), (5, 1, 5), (99, 1, 8), (4, 2, 3), (5, 2, 5), (99, 4, 7)],
)
def test_the_ends_are_held_and_so_is_each_shape(number: int, hold: int, shown: int) -> None:
    """Show the ends of the bake outside it, and each shape for the frames it is held."""
    assert shown_frame([3, 4, 5, 6, 7, 8], number, hold=hold) == shown


def test_held_frames_begin_with_the_first() -> None:
    """Count the frames that a shape is held from the first frame of the bake."""
    assert [held_frame(n, first=3, hold=2) for n in range(3, 8)] == [3, 3, 5, 5, 7]
    with pytest.raises(CacheMissingError):
        shown_frame([], 1, hold=1)
