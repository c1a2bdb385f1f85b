# SPDX-License-Identifier: GPL-3.0-or-later
"""A mouse over clay, without a window."""

import pytest

from tactile_clay.tests.clay_addon.sculpt.fake_mouse import Mouse


@pytest.fixture
def mouse() -> Mouse:
    """A mouse with a brush over a block of clay of ten centimetres."""
    return Mouse()
