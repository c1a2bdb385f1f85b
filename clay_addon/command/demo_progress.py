# SPDX-License-Identifier: GPL-3.0-or-later
"""How the demonstration tells how far it is, and where what libraries print goes meanwhile."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO


class DemoProgress:
    """A bar with the time left on a terminal, now and then a plain line elsewhere.

    Args:
        stream: Where to tell it.
        stages: How long each stage takes on two cores [s], in order; the time left is told from
            these, corrected by how long the stages so far have taken.
    """

    _WIDTH = 28

    def __init__(self, stream: IO[str], stages: Mapping[str, float]) -> None:
        self._stages = stages
        self._stream = stream
        self._bar = stream.isatty()
        self._began = time.perf_counter()
        self._stage = ""
        self._before = 0.0
        self._told = -1

    def start(self, stage: str) -> None:
        """Go on to a stage of those it was given."""
        self._before += self._stages.get(self._stage, 0.0)
        self._stage = stage
        self._told = -1
        self.advance(0.0, "")

    def advance(self, share: float, detail: str) -> None:
        """Tell how far the stage is.

        Args:
            share: Part of it that is done, 0 to 1.
            detail: What is being done.
        """
        total = sum(self._stages.values())
        done = self._before + share * self._stages[self._stage]
        elapsed = time.perf_counter() - self._began
        # The plan counts for as much as a quarter of its own length of experience.
        weight = done / (done + 0.25 * total)
        pace = weight * elapsed / max(done, 1e-6) + (1.0 - weight) if done else 1.0
        seconds = (total - done) * pace
        left = f"{seconds:.0f} s left" if seconds < 90 else f"{seconds / 60:.0f} min left"
        text = ", ".join(part for part in (self._stage, detail, left) if part)
        if self._bar:
            filled = round(self._WIDTH * done / total)
            bar = "█" * filled + "░" * (self._WIDTH - filled)
            self._stream.write(f"\r{bar} {text}\033[K")
        elif int(4 * share) > self._told:
            self._told = int(4 * share)
            self._stream.write(f"{text}\n")
        self._stream.flush()

    def end(self) -> None:
        """Leave the bar's line."""
        if self._bar:
            self._stream.write("\r\033[K")
            self._stream.flush()


@contextlib.contextmanager
def chatter_into(log: Path) -> Iterator[IO[str]]:
    """Send what libraries print to a file, and give a stream that still reaches the terminal."""
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    kept = os.dup(1), os.dup(2)
    with log.open("w", encoding="utf-8") as file, os.fdopen(os.dup(2), "w") as terminal:
        try:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
            yield terminal
        finally:
            for stream in (sys.stdout, sys.stderr):
                stream.flush()
            for number, copy in zip((1, 2), kept, strict=True):
                os.dup2(copy, number)
                os.close(copy)
