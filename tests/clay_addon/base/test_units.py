# SPDX-License-Identifier: GPL-3.0-or-later
"""Conversion between Blender units and meters."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tactile_clay.clay_addon.base.units import (
    from_meters,
    meters_per_unit,
    pose_from_meters,
    pose_to_meters,
    to_meters,
)

SCALES = (0.001, 0.01, 1.0, 100.0)
READERS = {"base/units.py", "core/brush/view_region.py"}
"""`core` must not import `base`, so its view region reads the scale from the context."""


def scene(scale: float) -> Any:
    """A stand-in for a scene, with only its unit settings."""
    return SimpleNamespace(unit_settings=SimpleNamespace(scale_length=scale))


@pytest.mark.parametrize("scale", SCALES)
def test_lengths_convert_both_ways(scale: float) -> None:
    """Convert a length to meters and back."""
    assert meters_per_unit(scene(scale)) == scale
    assert to_meters(scene(scale), 3.0) == pytest.approx(3.0 * scale)
    assert from_meters(scene(scale), to_meters(scene(scale), 3.0)) == pytest.approx(3.0)


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_points_keep_their_precision(scale: float, kind: Any) -> None:
    """Convert points without changing their type or the input array."""
    points = np.arange(6, dtype=kind).reshape(2, 3)
    turned = to_meters(scene(scale), points)
    assert turned.dtype == from_meters(scene(scale), points).dtype == kind
    np.testing.assert_allclose(turned, np.arange(6).reshape(2, 3) * scale, rtol=1e-6)
    np.testing.assert_array_equal(points, np.arange(6).reshape(2, 3))


@pytest.mark.parametrize("scale", SCALES)
def test_only_the_translation_of_poses_is_converted(scale: float) -> None:
    """Leave rotation and scale unchanged, for one pose and for many."""
    pose = np.diag([2.0, 3.0, 4.0, 1.0])
    pose[:3, 3] = 1.0, 2.0, 3.0
    for poses in (pose, np.stack([pose, pose])):
        turned = pose_to_meters(scene(scale), poses)
        np.testing.assert_array_equal(turned[..., :3, :3], poses[..., :3, :3])
        np.testing.assert_allclose(turned[..., :3, 3], poses[..., :3, 3] * scale)
        np.testing.assert_allclose(pose_from_meters(scene(scale), turned), poses)
    np.testing.assert_array_equal(pose[:3, 3], (1.0, 2.0, 3.0))


def test_only_the_units_module_reads_the_scale(repository: Path) -> None:
    """Keep the conversion in one module."""
    folder = repository / "clay_addon"
    readers = {
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*.py")
        if "scale_length" in path.read_text("utf-8")
    }
    assert readers == READERS
