# SPDX-License-Identifier: GPL-3.0-or-later
"""Only one activity at a time holds the clay."""

from collections.abc import Generator
from dataclasses import dataclass

import pytest

from tactile_clay.clay_addon.base.activity import ActivityKind, BusyError, ClayActivity


@dataclass(frozen=True)
class Step:
    """Progress after one step."""

    frame: int
    done: int = 0
    total: int = 3
    seconds_left: float | None = None


def work(log: list[str], *, fails: bool = False) -> Generator[Step, str | None, str]:
    """Three steps that log what they are sent and whether they are closed."""
    try:
        for frame in range(3):
            log.append(str((yield Step(frame))))
            if fails:
                raise ValueError("no more")
    except GeneratorExit:
        log.append("closed")
        raise
    return "done"


@pytest.mark.parametrize("kind", ActivityKind)
def test_second_activity_is_refused_with_how_to_end_the_first(kind: ActivityKind) -> None:
    """Say what holds the clay, and release it only when that ends."""
    activity = ClayActivity()
    with activity.held(kind):
        for other in ActivityKind:
            with pytest.raises(BusyError, match=r"Press (Esc|Finish)"):
                activity.begin(other)
        assert activity.kind is kind
    activity.check_free()


def test_progress_is_known_while_steps_run() -> None:
    """Keep the latest step, forward sent values, and return the result."""
    activity = ClayActivity()
    log: list[str] = []
    steps = activity.run_steps(ActivityKind.BAKE, work(log))
    assert next(steps) == activity.progress == Step(0)
    assert steps.send("a") == activity.progress == Step(1)
    assert steps.send("b") == Step(2)
    with pytest.raises(StopIteration) as ended:
        next(steps)
    assert ended.value.value == "done"
    assert log == ["a", "b", "None"]
    assert activity.kind is None


@pytest.mark.parametrize("how", ["closed", "failed", "dropped"])
def test_clay_is_free_however_an_activity_ends(how: str) -> None:
    """Release it when steps are closed, fail, or are garbage-collected."""
    activity = ClayActivity()
    log: list[str] = []
    steps = activity.run_steps(ActivityKind.DELIVERY, work(log, fails=how == "failed"))
    next(steps)
    assert activity.kind is ActivityKind.DELIVERY
    if how == "closed":
        steps.close()
    elif how == "failed":
        with pytest.raises(ValueError, match="no more"):
            next(steps)
    else:
        del steps
    assert activity.kind is None
    assert log == (["None"] if how == "failed" else ["closed"])


def test_refused_activity_leaves_the_first_one_in_place() -> None:
    """Keep the clay with the first activity when a second is refused."""
    activity = ClayActivity()
    activity.begin(ActivityKind.SCULPTING)
    with pytest.raises(BusyError):
        next(activity.run_steps(ActivityKind.BAKE, work([])))
    assert activity.kind is ActivityKind.SCULPTING
