# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces lie on the shapes that were filled, within a small part of the particle distance."""

import pytest

from tactile_clay.tests.experiments.surface_accuracy import measure


@pytest.mark.parametrize(("shape", "rms", "hausdorff"), [("sphere", 0.1, 0.5), ("box", 0.2, 0.8)])
def test_exact_surface_is_near_and_of_the_same_volume(shape: str, rms: float, hausdorff: float):
    """At 5 mm a sphere is met to a tenth of the spacing, a box but for its rounded edges."""
    found = measure("exact", shape, 0.005)
    assert abs(found.volume_error) < 0.003
    assert found.rms < rms * 0.005
    assert found.hausdorff < hausdorff * 0.005
