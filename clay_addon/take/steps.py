# SPDX-License-Identifier: GPL-3.0-or-later
"""The steps of a take while it is recorded: collected for two seconds, then written."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..core.take.data import Layout, Steps
from ..core.take.files import write_steps
from ..core.take.writer import TakeWriter
from .pose import StepRow

SECONDS_AT_RISK = 2.0
"""Simulated time in one file [s]: a crash costs at most this much."""


class TakeSteps:
    """Collects steps and events, and hands them to the writer.

    Args:
        directory: The take's folder.
        writer: Writes them.
        layout: What is recorded.
    """

    def __init__(self, directory: Path, writer: TakeWriter, layout: Layout) -> None:
        self.layout = layout
        self.unwritten: dict[int, Steps] = {}
        """Steps that are not on the disk yet, by the number of their file."""
        self._directory = directory
        self._writer = writer
        self._rows: list[StepRow] = []
        self._times: list[float] = []
        self._events: list[dict[str, Any]] = []
        self._count = 0
        self._files = 0

    def add(self, row: StepRow, seconds: float) -> bool:
        """Add a step that ended at a time [s]; whether a file was handed to the writer."""
        self._rows.append(row)
        self._times.append(seconds)
        full = seconds - self._times[0] >= SECONDS_AT_RISK
        return full and self.flush()

    def event(self, event: dict[str, Any]) -> None:
        """Add an edit or a rewind, and have it written at once."""
        self._events.append({"after": self._count + len(self._rows), **event})
        self.flush()

    def follow(self, layout: Layout) -> None:
        """Record something else from now on."""
        self.flush()
        self.layout = layout

    def flush(self) -> bool:
        """Hand what was collected to the writer; whether there was anything."""
        if not self._rows and not self._events:
            return False
        rows = self._rows or [_nothing(self.layout)]
        columns = StepRow(
            *(np.stack(column)[: len(self._rows)] for column in zip(*rows, strict=True))
        )
        steps = Steps(self.layout, np.array(self._times), *columns, self._events)
        number, self._files = self._files, self._files + 1
        self.unwritten[number] = steps
        self._count += len(self._rows)
        self._rows, self._times, self._events = [], [], []
        # Before the frames that wait, which can be computed again.
        self._writer.do(partial(self._write, number, steps), first=True)
        return True

    def _write(self, number: int, steps: Steps) -> None:
        write_steps(self._directory, number, steps)
        self.unwritten.pop(number, None)


def _nothing(layout: Layout) -> StepRow:
    """An empty row of a layout, for the shapes of its arrays."""
    bones = sum(len(names) for _, names in layout.armatures)
    return StepRow(
        np.zeros((len(layout.objects), 4, 4), np.float32),
        np.zeros((bones, 4, 4), np.float32),
        np.zeros(len(layout.armatures), np.float32),
        np.zeros(len(layout.colliders), bool),
        np.zeros((len(layout.tools), 4, 4), np.float32),
        np.zeros(len(layout.tools), bool),
    )
