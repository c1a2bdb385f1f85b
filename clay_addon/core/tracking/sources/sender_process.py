# SPDX-License-Identifier: GPL-3.0-or-later
"""A sender as a child process: it ends with its parent, and a crash of it is its own."""

from __future__ import annotations

import subprocess
import threading
from collections import deque
from collections.abc import Iterable, Sequence

from .. import TrackingError

NO_WINDOW: int = getattr(subprocess, "CREATE_NO_WINDOW", 0)
"""Keeps Windows from opening a console for a child process."""
_PATIENCE_SECONDS = 3.0


class SenderProcess:
    """Runs ``track SOURCE --attached``, which ends when its standard input does."""

    def __init__(self, command: Sequence[str]) -> None:
        """Start it.

        Raises:
            TrackingError: The program cannot be started.
        """
        try:
            self._process = subprocess.Popen(
                list(command),
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                encoding="utf-8",
                errors="replace",
                creationflags=NO_WINDOW,
            )
        except OSError as error:
            raise TrackingError(f"The sender cannot be started ({error}).") from error
        assert self._process.stderr is not None
        self._stopped = False
        self._lines: deque[str] = deque(maxlen=20)
        # It must never wait for someone to read what it tells.
        self._reader = threading.Thread(
            target=self._read, args=(self._process.stderr,), daemon=True
        )
        self._reader.start()

    @property
    def problem(self) -> str:
        """Why it ended by itself; empty while it runs, or where it ended well or was ended."""
        if self._stopped or self._process.poll() in (None, 0):
            return ""
        self._reader.join(timeout=1.0)
        return self._lines[-1] if self._lines else "The sender ended and did not say why."

    @property
    def runs(self) -> bool:
        """Whether it runs."""
        return self._process.poll() is None

    def stop(self) -> None:
        """End it; a second call does nothing."""
        assert self._process.stdin is not None
        self._stopped = True
        # What was never written cannot fail to be flushed, but the pipe may be gone.
        try:
            self._process.stdin.close()
            self._process.wait(timeout=_PATIENCE_SECONDS)
        except (OSError, subprocess.TimeoutExpired):
            self._process.kill()
            self._process.wait()
        self._reader.join(timeout=1.0)

    def _read(self, stream: Iterable[str]) -> None:
        for line in stream:
            if line.strip():
                self._lines.append(line.strip())
