# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows of arrays by clay object."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tactile_clay.clay_addon.core.storage.cache import Meta
from tactile_clay.clay_addon.core.storage.clay_layout import ClayLayout, ClaySlice

LAYOUT = ClayLayout([ClaySlice("Clay", 3), ClaySlice("Lump", 2)])


def test_rows_are_split_by_object_and_joined_again() -> None:
    """Splitting returns views of each object's rows; joining restores the array."""
    rows = np.arange(15.0, dtype=np.float32).reshape(5, 3)
    clay, lump = LAYOUT.split(rows)
    np.testing.assert_array_equal(clay, rows[:3])
    np.testing.assert_array_equal(lump, rows[3:])
    assert np.shares_memory(clay, rows)
    joined = LAYOUT.join([clay, lump])
    assert joined.dtype == np.float32
    np.testing.assert_array_equal(joined, rows)


def test_wrong_number_of_rows_is_refused() -> None:
    """Row counts that differ from the particle counts are refused, even if their sum is right."""
    with pytest.raises(ValueError, match="4 rows for 5 particles"):
        LAYOUT.split(np.zeros((4, 3)))
    with pytest.raises(ValueError, match="the objects"):
        LAYOUT.join([np.zeros((2, 3)), np.zeros((3, 3))])


def test_names_and_counts() -> None:
    """A layout lists the names and counts of its objects, and may be empty."""
    assert LAYOUT.names == ["Clay", "Lump"]
    assert LAYOUT.counts == [3, 2]
    assert LAYOUT.particle_count == 5
    assert ClayLayout().split(np.zeros((0, 3))) == []


def test_layout_is_stored_in_the_metadata_of_a_bake() -> None:
    """A layout is written as a list of objects, and read back equal."""
    meta = Meta(1, 2, 24.0, LAYOUT, {})
    text = meta.to_json()
    assert json.loads(text)["clay"] == [{"name": "Clay", "count": 3}, {"name": "Lump", "count": 2}]
    assert text == replace(meta, clay=tuple(LAYOUT)).to_json()
    assert Meta.from_json(text).layout == LAYOUT
