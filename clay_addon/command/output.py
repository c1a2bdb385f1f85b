# SPDX-License-Identifier: GPL-3.0-or-later
"""What the command line prints, and where: results, and how far it is."""

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
    return json.dumps(_without_nan(table), indent=2, default=str) if arguments.json else text


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_nan(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@contextlib.contextmanager
def diverted_output() -> Iterator[None]:
    """Send what Python and the C library print on the standard output to the standard error."""
    flush_output()
    kept = os.dup(1)
    try:
        os.dup2(2, 1)
        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        flush_output()
        os.dup2(kept, 1)
        os.close(kept)


def flush_output() -> None:
    """Flush the standard output, also the C library's, which Blender writes to."""
    sys.stdout.flush()
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None).fflush(None)


class ProgressLine:
    """Tells how far something is: a bar on a terminal, now and then a plain line elsewhere."""

    _WIDTH = 24

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream
        self._bar = stream.isatty()
        self._told = -1

    def __call__(self, progress: BakeProgress | DeliveryProgress) -> None:
        from ..core.readable import duration_text

        share = progress.done / max(1, progress.total)
        left = f"{duration_text(progress.seconds_left)} left"
        text = f"frame {progress.frame}, {progress.done} of {progress.total}, {left}"
        if self._bar:
            filled = round(self._WIDTH * share)
            bar = "█" * filled + "░" * (self._WIDTH - filled)
            self._stream.write(f"\r{bar} {text}\033[K")
            self._stream.flush()
        elif int(10 * share) > self._told:
            self._told = int(10 * share)
            print(text, file=self._stream, flush=True)

    def end(self) -> None:
        """Leave the bar's line."""
        if self._bar:
            self._stream.write("\n")
            self._stream.flush()
