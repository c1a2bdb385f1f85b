# SPDX-License-Identifier: GPL-3.0-or-later
"""Output of the command line: results and progress."""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import json
import math
import os
import sys
from collections.abc import Iterator
from typing import IO, TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..bake.bake import BakeProgress
    from ..deliver.delivery import DeliveryProgress


def output_text(arguments: argparse.Namespace, table: dict[str, Any], text: str) -> str:
    """The result of a command: the table as JSON with ``--json``, else the text."""
    return json.dumps(_without_nan(table), indent=2, default=str) if arguments.json else text


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_nan(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@contextlib.contextmanager
def stdout_to_stderr() -> Iterator[None]:
    """Redirect standard output of Python and the C library to standard error."""
    flush_output()
    previous = os.dup(1)
    try:
        os.dup2(2, 1)
        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        flush_output()
        os.dup2(previous, 1)
        os.close(previous)


def flush_output() -> None:
    """Flush standard output of Python and the C library, which Blender uses."""
    sys.stdout.flush()
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None).fflush(None)


class ProgressLine:
    """Prints progress: a bar on a terminal, else a line for every 10 %."""

    _WIDTH = 24

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream
        self._bar = stream.isatty()
        self._printed = -1

    def __call__(self, progress: BakeProgress | DeliveryProgress) -> None:
        from ..core.readable import duration_text

        fraction = progress.done / max(1, progress.total)
        left = f"{duration_text(progress.seconds_left)} left"
        text = f"frame {progress.frame}, {progress.done} of {progress.total}, {left}"
        if self._bar:
            filled = round(self._WIDTH * fraction)
            bar = "█" * filled + "░" * (self._WIDTH - filled)
            self._stream.write(f"\r{bar} {text}\033[K")
            self._stream.flush()
        elif int(10 * fraction) > self._printed:
            self._printed = int(10 * fraction)
            print(text, file=self._stream, flush=True)

    def end(self) -> None:
        """End the line of the bar."""
        if self._bar:
            self._stream.write("\n")
            self._stream.flush()
