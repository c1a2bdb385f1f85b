# SPDX-License-Identifier: GPL-3.0-or-later
"""Who holds the clay: a bake, a delivery or a sculpting session, one at a time.

All three change the clay, or the frame that it is shown at, over many seconds. Each takes hold of
it here before it begins and lets go when it ends, so that none needs to know the others.
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
    """What can hold the clay; the value says how to end it."""

    BAKE = "A bake is running. Press Esc to stop it first."
    DELIVERY = "A delivery is running. Press Esc to stop it first."
    SCULPTING = "The clay is being sculpted. Press Finish, or Esc in the 3D view, first."


class Progress(Protocol):
    """How far an activity is."""

    @property
    def frame(self) -> int:
        """The frame it is at."""

    @property
    def done(self) -> int:
        """Frames that are done."""

    @property
    def total(self) -> int:
        """Frames in all."""

    @property
    def seconds_left(self) -> float | None:
        """How long it will still take [s], once that can be told."""


_Step = TypeVar("_Step", bound=Progress)
_Sent = TypeVar("_Sent")
_Result = TypeVar("_Result")


class BusyError(TactileClayError):
    """Something else holds the clay; the message says what, and how to end it."""


class ClayActivity:
    """What holds the clay now."""

    def __init__(self) -> None:
        self.kind: ActivityKind | None = None
        """What holds it; None while nothing does."""
        self.progress: Progress | None = None
        """How far that is, where it goes frame by frame."""
        self.pace = 1.0
        """Simulated time over real time while clay is worked live; 1 otherwise."""

    def check_free(self) -> None:
        """Refuse while something holds the clay.

        Raises:
            BusyError: Something does.
        """
        if self.kind is not None:
            raise BusyError(self.kind.value)

    def begin(self, kind: ActivityKind) -> None:
        """Take hold of the clay, until `end`.

        Raises:
            BusyError: Something else holds it.
        """
        self.check_free()
        self.kind, self.progress = kind, None
        _logger.info("%s begins", kind.name.capitalize())

    def end(self) -> None:
        """Let go of the clay; nothing where nothing holds it."""
        if self.kind is not None:
            _logger.info("%s ends", self.kind.name.capitalize())
        self.kind = self.progress = None
        self.pace = 1.0

    @contextmanager
    def held(self, kind: ActivityKind) -> Iterator[None]:
        """Hold the clay inside the context.

        Raises:
            BusyError: Something else holds it.
        """
        self.begin(kind)
        try:
            yield
        finally:
            self.end()

    def through(
        self, kind: ActivityKind, steps: Generator[_Step, _Sent, _Result]
    ) -> Generator[_Step, _Sent, _Result]:
        """Go through the steps of a work that holds the clay, and keep how far it is.

        Args:
            kind: What the work is.
            steps: The work; closed with this, whichever way it ends.

        Raises:
            BusyError: Something else holds the clay.
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
"""What holds the clay in this Blender."""


def register() -> None:
    """Nothing holds the clay yet."""
    clay_activity.end()


def unregister() -> None:
    """Forget what Blender ended with the add-on."""
    clay_activity.end()
