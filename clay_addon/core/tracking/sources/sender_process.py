# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs a sender as a child process, which exits with its parent and cannot crash it."""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Iterable, Sequence

from .. import TrackingError

NO_WINDOW: int = getattr(subprocess, "CREATE_NO_WINDOW", 0)
"""Keeps Windows from opening a console for a child process."""
_STOP_TIMEOUT_SECONDS = 3.0


class SenderProcess:
    """Runs ``track SOURCE --attached``, which exits when its standard input is closed."""

    def __init__(self, command: Sequence[str]) -> None:
        """Start the process.

        Args:
            command: Program and arguments.

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
        self._last_line = ""
        # The process must never block on a full pipe.
        self._reader = threading.Thread(
            target=self._read, args=(self._process.stderr,), daemon=True
        )
        self._reader.start()

    @property
    def problem(self) -> str:
        """Why the process failed; empty while it runs, after success, or after `stop`."""
        if self._stopped or self._process.poll() in (None, 0):
            return ""
        self._reader.join(timeout=1.0)
        return self._last_line or "The sender exited without an error message."

    @property
    def runs(self) -> bool:
        """Whether the process is running."""
        return self._process.poll() is None

    def stop(self) -> None:
        """Stop the process; a second call does nothing."""
        assert self._process.stdin is not None
        self._stopped = True
        try:
            self._process.stdin.close()
            self._process.wait(timeout=_STOP_TIMEOUT_SECONDS)
        except (OSError, subprocess.TimeoutExpired):
            self._process.kill()
            self._process.wait()
        self._reader.join(timeout=1.0)

    def _read(self, stream: Iterable[str]) -> None:
        for line in stream:
            if line.strip():
                self._last_line = line.strip()
