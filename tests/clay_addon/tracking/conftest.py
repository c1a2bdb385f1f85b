# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures of the tracking tests."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from tactile_clay.clay_addon.tracking.receiver import Receiver
from tactile_clay.tests.clay_addon.tracking.hands import Clock, leap_recordings


@pytest.fixture
def clock() -> Clock:
    """A clock that stands until it is turned."""
    return Clock()


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    """A receiver on a port of the system's choice."""
    with Receiver(0) as receiver:
        yield receiver


# How long an example takes says nothing on a machine that does other things as well.
settings.register_profile("unhurried", deadline=None)
settings.load_profile("unhurried")

_RECORDINGS: list[Path | None] = [*leap_recordings()] or [None]


@pytest.fixture(params=_RECORDINGS, ids=lambda path: path.name if path else "none")
def leap_recording(request: pytest.FixtureRequest) -> Any:
    """Each of the real recordings."""
    if request.param is None:
        pytest.skip("the Leap recordings are not here")
    path: Path = request.param
    return path
