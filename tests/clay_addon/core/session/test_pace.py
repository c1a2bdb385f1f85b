# SPDX-License-Identifier: GPL-3.0-or-later
"""The pace of a live session, on computers and in windows of several speeds."""

import pytest

from tactile_clay.clay_addon.core.session.pace import STEP_SECONDS, Pace


def run(cost: float, tick: float, *, seconds: float = 4.0) -> tuple[Pace, list[float], float]:
    """A session whose steps cost so much [s/s], looked after at each tick [s] at most."""
    pace, now, durations = Pace(), 0.0, []
    while now < seconds:
        duration = pace.next(now)
        if duration:
            durations.append(duration)
            pace.took(duration, duration * cost)
        now += max(tick, duration * cost)
    return pace, durations, now


@pytest.mark.parametrize("tick", [1 / 120, 1 / 60, 1 / 30, 1 / 10])
def test_fast_solver_keeps_up_at_any_tick(tick: float) -> None:
    """Simulate as much time as passes, however seldom the window has time."""
    pace, _, now = run(0.3, tick)
    assert pace.simulated == pytest.approx(now, rel=0.05)
    assert pace.factor(now) > 0.9


def test_slow_solver_falls_behind_and_says_so() -> None:
    """Show how slow it is, in steps that do not grow."""
    pace, durations, now = run(5.0, 1 / 120)
    assert pace.simulated == pytest.approx(now / 5.0, rel=0.1)
    assert pace.factor(now) == pytest.approx(0.2, abs=0.03)
    assert max(durations[2:]) == pytest.approx(STEP_SECONDS)


def test_window_that_stands_still_is_not_real_time() -> None:
    """Say that time goes by slowly also where a step takes longer than the factor's window."""
    pace = Pace()
    for now in (0.0, 3.0, 6.0):
        pace.next(now)
        pace.took(STEP_SECONDS, 3.0)
    assert pace.factor(9.0) < 0.02


def test_slow_window_leaves_the_solver_to_work() -> None:
    """Let a slow solver work while the window is drawn: the two take turns otherwise."""
    pace, _, now = run(2.0, 0.25, seconds=20.0)
    assert pace.simulated > 0.7 * now / 2.0


def test_time_of_a_pause_does_not_count() -> None:
    """Go on after a pause as if there had been none."""
    pace = Pace()
    pace.next(0.0)
    pace.pause()
    assert pace.next(100.0) == pytest.approx(STEP_SECONDS)
