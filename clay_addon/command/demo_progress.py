# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress of the demo, and redirection of the output of libraries."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO


class DemoProgress:
    """Prints progress and remaining time: a bar on a terminal, else occasional lines.

    Args:
        stream: Stream to print to.
        stages: Durations of the stages on two cores [s], in order, for the remaining time, which
            is corrected by the actual durations so far.
    """

    _WIDTH = 28

    def __init__(self, stream: IO[str], stages: Mapping[str, float]) -> None:
        self._stages = stages
        self._stream = stream
        self._bar = stream.isatty()
        self._began = time.perf_counter()
        self._stage = ""
        self._before = 0.0
        self._printed = -1

    def start(self, stage: str) -> None:
        """Start a stage."""
        self._before += self._stages.get(self._stage, 0.0)
        self._stage = stage
        self._printed = -1
        self.advance(0.0, "")

    def advance(self, fraction: float, detail: str) -> None:
        """Print the progress of the current stage.

        Args:
            fraction: Completed fraction of the stage, 0 to 1.
            detail: Description of the current work.
        """
        total = sum(self._stages.values())
        done = self._before + fraction * self._stages[self._stage]
        elapsed = time.perf_counter() - self._began
        # The planned pace has the weight of a quarter of the total duration.
        weight = done / (done + 0.25 * total)
        pace = weight * elapsed / max(done, 1e-6) + (1.0 - weight) if done else 1.0
        seconds = (total - done) * pace
        left = f"{seconds:.0f} s left" if seconds < 90 else f"{seconds / 60:.0f} min left"
        text = ", ".join(part for part in (self._stage, detail, left) if part)
        if self._bar:
            filled = round(self._WIDTH * done / total)
            bar = "█" * filled + "░" * (self._WIDTH - filled)
            self._stream.write(f"\r{bar} {text}\033[K")
        elif int(4 * fraction) > self._printed:
            self._printed = int(4 * fraction)
            self._stream.write(f"{text}\n")
        self._stream.flush()

    def end(self) -> None:
        """Clear the bar."""
        if self._bar:
            self._stream.write("\r\033[K")
            self._stream.flush()


@contextlib.contextmanager
def redirected_output(log: Path) -> Iterator[IO[str]]:
    """Redirect output to a log file, and yield a stream to the terminal."""
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    previous = os.dup(1), os.dup(2)
    with log.open("w", encoding="utf-8") as file, os.fdopen(os.dup(2), "w") as terminal:
        try:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
            yield terminal
        finally:
            for stream in (sys.stdout, sys.stderr):
                stream.flush()
            for number, copy in zip((1, 2), previous, strict=True):
                os.dup2(copy, number)
                os.close(copy)
