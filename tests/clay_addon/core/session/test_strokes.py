# SPDX-License-Identifier: GPL-3.0-or-later
"""When strokes end."""

from tactile_clay.clay_addon.core.session.strokes import StrokeWatch


def test_a_stroke_of_the_mouse_ends_with_its_release() -> None:
    """Report the end once, as soon as the mouse has let go."""
    watch = StrokeWatch()
    assert not watch.has_ended(0.0, stroking=True)
    watch.touched(0.1)
    assert not watch.has_ended(5.0, stroking=True)
    assert watch.open
    assert watch.has_ended(5.1, stroking=False)
    assert not watch.open
    assert not watch.has_ended(9.0, stroking=False)


def test_a_stroke_that_touched_nothing_does_not_count() -> None:
    """Report no end where the clay was never touched."""
    watch = StrokeWatch()
    assert not watch.has_ended(0.0, stroking=True)
    assert not watch.has_ended(1.0, stroking=False)


def test_hands_end_a_stroke_when_they_leave_the_clay_alone() -> None:
    """Wait a while after the last touch, since hands have no button."""
    watch = StrokeWatch()
    watch.touched(1.0)
    assert not watch.has_ended(1.3, stroking=False)
    watch.touched(1.3)
    assert not watch.has_ended(1.6, stroking=False)
    assert watch.has_ended(1.8, stroking=False)
