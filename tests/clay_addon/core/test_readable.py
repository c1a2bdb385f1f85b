# SPDX-License-Identifier: GPL-3.0-or-later
"""Human-readable durations and sizes."""

import pytest

from tactile_clay.clay_addon.core.readable import duration_text, size_text


@pytest.mark.parametrize(
    ("seconds", "text"), [(None, "…"), (0.4, "0 s"), (75, "1 min 15 s"), (7300, "2 h 01 min")]
)
def test_durations_are_readable(seconds: float | None, text: str) -> None:
    """Write a duration in suitable units."""
    assert duration_text(seconds) == text


@pytest.mark.parametrize(
    ("size", "text"), [(0, "0 bytes"), (999, "999 bytes"), (12_345, "12.3 kB"), (5e12, "5e+03 GB")]
)
def test_sizes_are_readable(size: int, text: str) -> None:
    """Write a size in suitable units."""
    assert size_text(size) == text
