# SPDX-License-Identifier: GPL-3.0-or-later
"""A webcam, a video file or images as a source of hands, through MediaPipe."""

from __future__ import annotations

import subprocess
import threading
import time
from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from .. import TrackingError
from ..formats.mediapipe import MediapipeHands
from .mediapipe_setup import MODEL, environment_python
from .sender import Sighting, sighting
from .sender_process import NO_WINDOW

_WORKER = Path(__file__).with_name("mediapipe_worker.py")


def mediapipe(
    inputs: Sequence[str],
    environment: Path,
    hands: MediapipeHands,
    *,
    paced: bool = True,
    clock: Callable[[], int] = time.perf_counter_ns,
    sleep: Callable[[float], object] = time.sleep,
) -> Generator[Sighting, None, None]:
    """Yield the hands that MediaPipe detects.

    Args:
        inputs: A camera index, a video file, or images.
        environment: Folder of the environment made by `mediapipe_setup.set_up`.
        hands: Converts landmarks to hands.
        paced: Whether to play a video at its own speed, and images at one per second, if the
            machine keeps up; otherwise as fast as possible.
        clock: The time [ns].
        sleep: Waits for a number of seconds.

    Raises:
        TrackingError: MediaPipe is not set up or has failed, or the input cannot be opened.
    """
    python = environment_python(environment)
    live = len(inputs) == 1 and inputs[0].isdigit()
    for name in inputs:
        if not live and not Path(name).is_file():
            raise TrackingError(f"The file {name} does not exist.")
    command = [str(python), str(_WORKER), "--model", str(environment / MODEL), *inputs]
    start = None
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        creationflags=NO_WINDOW,
    ) as worker:
        assert worker.stdout is not None
        assert worker.stderr is not None
        errors = _LastLine(worker.stderr)
        try:
            for line in worker.stdout:
                frames = hands.read(line)
                if hands.time is None:
                    continue
                moment = hands.time
                if not live:
                    start = clock() - hands.time if start is None else start
                    moment = start + hands.time
                    ahead = moment - clock()
                    if ahead < 0:
                        # Detection does not keep up, so the video plays more slowly.
                        start, moment = start - ahead, moment - ahead
                    elif paced:
                        sleep(ahead * 1e-9)
                yield sighting([replace(frame, source_time=moment) for frame in frames], moment)
            if worker.wait() != 0:
                raise TrackingError(f"MediaPipe stopped: {errors.text()}")
        finally:
            worker.kill()


class _LastLine:
    """Drains a process's standard error, so that it never blocks, and keeps the last line."""

    def __init__(self, stream: Iterable[str]) -> None:
        self._line = ""
        self._thread = threading.Thread(target=self._read, args=(stream,), daemon=True)
        self._thread.start()

    def _read(self, stream: Iterable[str]) -> None:
        for line in stream:
            # Skip the log messages of MediaPipe and OpenCV.
            if line.strip() and not line.startswith(("INFO", "WARNING", "W0", "I0", "[")):
                self._line = line.strip()

    def text(self) -> str:
        """The last line."""
        self._thread.join(timeout=2.0)
        return self._line or "no error message."
