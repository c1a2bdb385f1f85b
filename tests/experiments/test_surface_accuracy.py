# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces match the filled shapes within a small fraction of the spacing."""

import pytest

from tactile_clay.tests.experiments.surface_accuracy import measure


@pytest.mark.parametrize(("shape", "rms", "hausdorff"), [("sphere", 0.1, 0.5), ("box", 0.2, 0.8)])
def test_exact_surface_is_near_and_of_the_same_volume(shape: str, rms: float, hausdorff: float):
    """Match a sphere to a tenth of the spacing, and a box except for its rounded edges."""
    found = measure("exact", shape, 0.005)
    assert abs(found.volume_error) < 0.003
    assert found.rms < rms * 0.005
    assert found.hausdorff < hausdorff * 0.005
