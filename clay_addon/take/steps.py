# SPDX-License-Identifier: GPL-3.0-or-later
"""Buffer for the steps of a take during the recording, written every two seconds."""

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
"""Simulated time in one file [s]: a crash loses at most this much."""


class TakeSteps:
    """Collects steps and events, and passes them to the writer.

    Args:
        directory: Folder of the take.
        writer: Thread that writes the files.
        layout: Objects to record.
    """

    def __init__(self, directory: Path, writer: TakeWriter, layout: Layout) -> None:
        self.layout = layout
        self.unwritten: dict[int, Steps] = {}
        """Steps not yet on disk, by file number."""
        self._directory = directory
        self._writer = writer
        self._rows: list[StepRow] = []
        self._times: list[float] = []
        self._events: list[dict[str, Any]] = []
        self._count = 0
        self._files = 0

    def add(self, row: StepRow, seconds: float) -> bool:
        """Add a step that ended at a time [s], and return whether steps were passed on."""
        self._rows.append(row)
        self._times.append(seconds)
        full = seconds - self._times[0] >= SECONDS_AT_RISK
        return full and self.flush()

    def event(self, event: dict[str, Any]) -> None:
        """Add an edit or rewind, and pass it on at once."""
        self._events.append({"after": self._count + len(self._rows), **event})
        self.flush()

    def set_layout(self, layout: Layout) -> None:
        """Change the recorded objects from now on."""
        self.flush()
        self.layout = layout

    def flush(self) -> bool:
        """Pass collected steps and events to the writer, and return whether there were any."""
        if not self._rows and not self._events:
            return False
        rows = self._rows or [_empty_row(self.layout)]
        columns = StepRow(
            *(np.stack(column)[: len(self._rows)] for column in zip(*rows, strict=True))
        )
        steps = Steps(self.layout, np.array(self._times), *columns, self._events)
        number, self._files = self._files, self._files + 1
        self.unwritten[number] = steps
        self._count += len(self._rows)
        self._rows, self._times, self._events = [], [], []
        # Ahead of waiting frames, which can be computed again.
        self._writer.do(partial(self._write, number, steps), first=True)
        return True

    def _write(self, number: int, steps: Steps) -> None:
        write_steps(self._directory, number, steps)
        self.unwritten.pop(number, None)


def _empty_row(layout: Layout) -> StepRow:
    """A row of zeros in the array shapes of a layout."""
    bones = sum(len(names) for _, names in layout.armatures)
    return StepRow(
        np.zeros((len(layout.objects), 4, 4), np.float32),
        np.zeros((bones, 4, 4), np.float32),
        np.zeros(len(layout.armatures), np.float32),
        np.zeros(len(layout.colliders), bool),
        np.zeros((len(layout.tools), 4, 4), np.float32),
        np.zeros(len(layout.tools), bool),
    )
