# SPDX-License-Identifier: GPL-3.0-or-later
"""Which activity holds the clay: a bake, a delivery or a sculpting session, one at a time.

All three change the clay or the current frame over many seconds. Each acquires the clay here
before it begins and releases it when it ends, so none needs to know about the others.
"""

from __future__ import annotations

import logging
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager
from enum import Enum
from typing import Protocol, TypeVar

from ...solver.core.errors import TactileClayError

_logger = logging.getLogger(__name__)


class ActivityKind(Enum):
    """Activities that can hold the clay; the value tells the user how to end them."""

    BAKE = "A bake is running. Press Esc to stop it first."
    DELIVERY = "A delivery is running. Press Esc to stop it first."
    SCULPTING = "The clay is being sculpted. Press Finish, or Esc in the 3D view, first."


class Progress(Protocol):
    """Progress of an activity."""

    @property
    def frame(self) -> int:
        """Current frame."""

    @property
    def done(self) -> int:
        """Number of frames done."""

    @property
    def total(self) -> int:
        """Total number of frames."""

    @property
    def seconds_left(self) -> float | None:
        """Estimated time left [s]; None until it can be estimated."""


_Step = TypeVar("_Step", bound=Progress)
_Sent = TypeVar("_Sent")
_Result = TypeVar("_Result")


class BusyError(TactileClayError):
    """Another activity holds the clay; the message says which, and how to end it."""


class ClayActivity:
    """The activity that holds the clay, if any."""

    def __init__(self) -> None:
        self.kind: ActivityKind | None = None
        """The activity; None if the clay is free."""
        self.progress: Progress | None = None
        """How far that is, where it goes frame by frame."""
        self.pace = 1.0
        """Simulated time over real time while clay is worked live; 1 otherwise."""

    def check_free(self) -> None:
        """Check that nothing holds the clay.

        Raises:
            BusyError: An activity holds it.
        """
        if self.kind is not None:
            raise BusyError(self.kind.value)

    def begin(self, kind: ActivityKind) -> None:
        """Acquire the clay, until `end`.

        Raises:
            BusyError: Another activity holds it.
        """
        self.check_free()
        self.kind, self.progress = kind, None
        _logger.info("%s begins", kind.name.capitalize())

    def end(self) -> None:
        """Release the clay; does nothing if it is free."""
        if self.kind is not None:
            _logger.info("%s ends", self.kind.name.capitalize())
        self.kind = self.progress = None
        self.pace = 1.0

    @contextmanager
    def held(self, kind: ActivityKind) -> Iterator[None]:
        """Hold the clay within the context.

        Raises:
            BusyError: Another activity holds it.
        """
        self.begin(kind)
        try:
            yield
        finally:
            self.end()

    def run_steps(
        self, kind: ActivityKind, steps: Generator[_Step, _Sent, _Result]
    ) -> Generator[_Step, _Sent, _Result]:
        """Hold the clay while running a generator's steps, and keep its progress.

        Args:
            kind: The activity.
            steps: Yields progress; closed when this generator ends, however it ends.

        Raises:
            BusyError: Another activity holds the clay.
        """
        with closing(steps), self.held(kind):
            try:
                step = next(steps)
                while True:
                    self.progress = step
                    step = steps.send((yield step))
            except StopIteration as finished:
                result: _Result = finished.value
                return result


clay_activity = ClayActivity()
"""The one instance of this Blender process."""


def register() -> None:
    """Start with the clay free."""
    clay_activity.end()


def unregister() -> None:
    """Release the clay: Blender ends any activity along with the add-on."""
    clay_activity.end()
